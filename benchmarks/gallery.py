"""The gallery: the cost of each example against its reference, the time of a second call, and the certificate.

``--ipopt`` prints the references of the examples without a closed form anew: IPOPT on the same transcription, from the
example's guess and three random ones. It does not call the solver.

    python -m benchmarks.gallery [--json] [--only NAME ...] [--ipopt]
"""

import argparse
import dataclasses
import json
import sys
import time
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jaxscp as js  # noqa: E402
from examples import GALLERY, example  # noqa: E402
from examples.support import BEST_OF_IPOPT  # noqa: E402


def solved(name: str) -> dict[str, Any]:
    """Figures of one example. A second call is timed."""
    module = example(name)
    problem = module.problem()
    guess = module.guess(problem)
    jax.block_until_ready(js.solve(problem, guess))
    began = time.perf_counter()
    solution = jax.block_until_ready(js.solve(problem, guess))
    seconds = time.perf_counter() - began
    return {
        "problem": name,
        "status": str(js.status_names(solution.status)),
        "certified": bool(solution.certificate.passed()),
        "seconds": seconds,
        "iterations": int(solution.iterations),
        "value": float(solution.cost),
        "reference": module.REFERENCE.value,
        "relative_error": module.REFERENCE.error(solution.cost),
        "allowed": module.REFERENCE.tolerance,
        "source": module.REFERENCE.source,
    }


def compare(names: list[str], echo: Any) -> dict[str, Any]:
    """Figures of the gallery."""
    echo(
        f"{'problem':18} {'status':20} {'s':>7} {'subpr.':>6} {'value':>11} {'reference':>11} {'error':>8}  source"
    )
    rows = []
    for name in names:
        row = solved(name)
        rows.append(row)
        echo(
            f"{name:18} {row['status']:20} {row['seconds']:7.3f} {row['iterations']:6d} {row['value']:11.6g} "
            f"{row['reference']:11.6g} {row['relative_error']:8.1e}  {row['source']}"
        )
    certified = sum(row["certified"] and row["status"] == "converged" for row in rows)
    return {
        "problems": rows,
        "worst_relative_error": max(row["relative_error"] for row in rows),
        "certified_share": certified / len(rows),
        "within_allowed": all(row["relative_error"] <= row["allowed"] for row in rows),
    }


def references(names: list[str], echo: Any) -> dict[str, Any]:
    """Results of IPOPT, and the best of each example."""
    from benchmarks.rivals.any_problem import AnyProblem  # needs the extra benchmarks
    from benchmarks.rivals.optimum import best

    found = {}
    for name in names:
        module = example(name)
        if module.REFERENCE.tolerance != BEST_OF_IPOPT:
            continue
        problem = module.problem()
        starts = AnyProblem(problem, module.guess(problem)).solve()
        for start in starts:
            echo(f"{name:18} {start.cost:12.7g} {start.iterations:5d} {start.seconds:7.1f} s  {start.status}")
        found[name] = {"best": best(starts), "starts": [dataclasses.asdict(start) for start in starts]}
        echo(f"{name:18} best {found[name]['best']:.7g}")
    return found


def main() -> None:
    """Print the figures; the exit code is 1 if an example misses its reference."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--only", nargs="+", choices=GALLERY, default=list(GALLERY), help="these examples")
    parser.add_argument("--ipopt", action="store_true", help="print IPOPT's references")
    options = parser.parse_args()

    def echo(line: str) -> None:
        print(line, file=sys.stderr if options.json else sys.stdout, flush=True)

    result = (references if options.ipopt else compare)(options.only, echo)
    if options.json:
        print(json.dumps(result))
    elif not options.ipopt:
        echo("\n".join(f"{key}: {value}" for key, value in result.items() if key != "problems"))
    if not options.ipopt and not (result["within_allowed"] and result["certified_share"] == 1.0):
        sys.exit(1)


if __name__ == "__main__":
    main()
