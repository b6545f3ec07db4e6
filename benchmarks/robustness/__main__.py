"""Random chains, limits, vehicles, units, re-plans and a receding horizon: how many plans hold.

python -m benchmarks.robustness [--json] [--count 200] [--seed 0] [--parts chains limits ...]
"""

import argparse
import json
import sys
import time
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

from benchmarks.robustness import parts  # noqa: E402

PARTS = {
    "chains": parts.chains,
    "chains-of-four": parts.chains_of_four,
    "limits": parts.limits,
    "vehicles": parts.vehicles,
    "units": parts.units,
    "replans": parts.replans,
    "horizon": parts.horizon,
    "in-flight": parts.in_flight,
}


def main() -> None:
    """Run the parts and print their figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object, the rest on stderr")
    parser.add_argument(
        "--count",
        type=int,
        default=200,
        help="chains; re-plans, and a twentieth of the flights, and of the chains of in-flight",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the first chain")
    parser.add_argument(
        "--parts", nargs="+", choices=tuple(PARTS), default=tuple(PARTS), help="all by default"
    )
    options = parser.parse_args()
    stream = sys.stderr if options.json else sys.stdout
    began, found = time.perf_counter(), {}

    def echo(line: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {line}", file=stream, flush=True)

    for name in options.parts:
        result: dict[str, Any] = PARTS[name](options.count, options.seed, echo)
        echo(", ".join(f"{key} {value}" for key, value in result.items()))
        found |= result
    if options.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
