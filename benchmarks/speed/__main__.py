"""Benchmarks of speed: parts of a solve, rivals, sizes, cold starts and batches.

    python -m benchmarks.speed [--json] [--check] [--only PART ...] [--gpu] [--nodes 30] [--repeats 7]
                               [--batch 4096] [--total 65536]

Parts: ``profile``, ``rivals`` (extra ``benchmarks``), ``scaling``, ``starts``, ``levels``, ``many``, ``alone``,
``batches``, ``mappings``. The default is the first six; ``--gpu`` runs ``alone``, ``batches`` and ``many``. ``--check``
compares the ratios with benchmarks/baseline.json. The exit code is 1 if a ratio is worse by more than a factor of 1.5.
"""

import argparse
import json
import platform
import sys
from collections.abc import Callable
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

PARTS = ("profile", "rivals", "scaling", "starts", "levels", "many")
FOR_ACCELERATORS = ("alone", "batches", "many")


def measure(part: str, options: argparse.Namespace, echo: Callable[[str], None]) -> dict[str, Any]:
    """Figures of one part. Imports only the modules of this part: not every machine has the rivals."""
    match part:
        case "profile":
            from benchmarks.speed import profile

            return {"profile": profile.run(echo, options.nodes)}
        case "rivals":
            from benchmarks.speed import rivals

            return rivals.run(echo, options.nodes, options.repeats)
        case "scaling":
            from benchmarks.speed import scaling

            return scaling.run(echo)
        case "starts":
            from benchmarks.speed import starts

            return starts.run(echo, options.nodes)
        case "levels":
            from benchmarks.speed import levels

            return levels.run(echo, options.nodes, options.repeats)
        case "many":
            from benchmarks.speed import many

            return many.run(echo, options.nodes, options.batch, options.total)
        case "mappings":
            from benchmarks.speed import mappings

            return mappings.run(echo)
        case "alone":
            from benchmarks.speed import alone

            return alone.run(echo, options.nodes, options.batch)
        case _:
            from benchmarks.speed import batches

            return batches.run(echo, options.nodes, options.batch, options.total)


def main() -> int:
    """Measure, print, and with ``--check`` compare; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object, the tables on stderr")
    parser.add_argument("--check", action="store_true", help="compare ratios with benchmarks/baseline.json")
    parser.add_argument(
        "--only", nargs="+", choices=(*PARTS, "alone", "batches", "mappings"), help="these parts alone"
    )
    parser.add_argument("--gpu", action="store_true", help="the parts for accelerators")
    parser.add_argument("--nodes", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=7, help="of a plan that is compared with a rival's")
    parser.add_argument("--batch", type=int, default=4096, help="plans at once")
    parser.add_argument("--total", type=int, default=65536, help="plans in one call, by chunks of --batch")
    options = parser.parse_args()

    def echo(line: str) -> None:
        print(line, file=sys.stderr if options.json else sys.stdout, flush=True)

    found: dict[str, Any] = {"machine": platform.machine(), "device": jax.devices()[0].device_kind}
    for part in options.only or (FOR_ACCELERATORS if options.gpu else PARTS):
        found |= measure(part, options, echo)
    worse = []
    if options.check:
        from benchmarks.speed import check

        worse = check.regressions(found, echo)
    if options.json:
        print(json.dumps(found))
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
