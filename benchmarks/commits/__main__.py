"""Two commits compared: whether they plan the same, bit by bit, and how long each takes.

    python -m benchmarks.commits OLD [NEW] [--only numbers|times] [--quick] [--pairs 10] [--tolerance 0]
                                 [--builds FOLDER] [--json]

It ends with 1 where the numbers differ. Needs hatchling and a C++ compiler, as every build of jaxscp from its source.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.commits import equality, times
from benchmarks.commits.builds import WORKING_TREE, build_both


def main() -> int:
    """Build both, compare, measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("old", help="a commit, by any name that git knows")
    parser.add_argument("new", nargs="?", default=WORKING_TREE, help="another; without one, the working tree")
    parser.add_argument("--only", choices=("numbers", "times"), help="one of the two parts")
    parser.add_argument(
        "--quick", action="store_true", help="of the numbers, the plans by the best libraries alone"
    )
    parser.add_argument("--pairs", type=int, default=10, help="of times")
    parser.add_argument(
        "--tolerance", type=float, default=0.0, help="relative difference of floats that counts as none"
    )
    parser.add_argument("--builds", type=Path, help="folder where packages of commits stay for later runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object, the rest on stderr")
    options = parser.parse_args()
    began = time.perf_counter()

    def echo(line: str) -> None:
        stream = sys.stderr if options.json else sys.stdout
        print(f"{time.perf_counter() - began:5.0f} s  {line}", file=stream, flush=True)

    with tempfile.TemporaryDirectory(prefix="jaxscp-") as scratch:
        echo("building both")
        old, new = build_both(options.old, options.new, Path(scratch), options.builds)
        echo(f"old: {old.name}; new: {new.name}; levels: {', '.join(new.levels())}")
        found: dict[str, Any] = {"old": old.name, "new": new.name}
        if options.only != "times":
            found["numbers"] = equality.run(old, new, options.tolerance, options.quick, echo)
        if options.only != "numbers":
            found["times"] = times.run(old, new, options.pairs, echo)
    equal = found.get("numbers", {}).get("equal", True)
    if "numbers" in found:
        echo("the numbers are equal" if equal else "the numbers differ")
    if options.json:
        print(json.dumps(found))
    return 0 if equal else 1


if __name__ == "__main__":
    sys.exit(main())
