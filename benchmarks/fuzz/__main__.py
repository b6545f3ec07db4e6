"""Random inputs of every kind: scenarios, corridors, clouds, files, commands; about half of them are wrong.

python -m benchmarks.fuzz --count 200 [--seconds 7200] [--seed 0] [--first 0] [--kinds scenario file ...]
                       [--workers 2] [--json]

Faults are a crash, a hang, an exception that is no message, NaN in a converged plan, and a converged plan that SciPy
refutes. Faults, and refusals of valid inputs, are printed at once. ``--first NUMBER --count 1`` runs one case again.
"""

import argparse
import json
import sys
import time
from collections import Counter

import jax

jax.config.update("jax_enable_x64", True)

from benchmarks.fuzz.case import FAULTS, GOOD, Record  # noqa: E402
from benchmarks.fuzz.driver import KINDS, run_all  # noqa: E402

EVERY = 50  # cases between two lines of progress


def summary(records: list[Record], seconds: float) -> dict:
    """Figures of a run."""
    count, valid = max(len(records), 1), [record for record in records if not record.mutation]
    bad = [record for record in valid if record.ending not in GOOD]
    return {
        "count": len(records),
        "seconds": round(seconds, 1),
        "per_second": round(len(records) / max(seconds, 1e-9), 2),
        "valid_fraction": round(len(valid) / count, 3),
        "converged_fraction": round(sum(record.ending == "converged" for record in records) / count, 3),
        "valid_and_good_fraction": round(1.0 - len(bad) / max(len(valid), 1), 3),
        "valid_and_not_good": _endings(bad),
        "faults": {fault: sum(record.ending == fault for record in records) for fault in FAULTS},
        "kinds": _endings(records),
        "seconds_a_case": {
            kind: round(sum(times) / len(times), 3)
            for kind in KINDS
            if (times := [record.seconds for record in records if record.kind == kind])
        },
        "slowest_s": round(max((record.seconds for record in records), default=0.0), 1),
        "cases": [record._asdict() for record in records if record.ending in FAULTS],
    }


def _endings(records: list[Record]) -> dict[str, dict[str, int]]:
    """Number of each ending, by kind."""
    counts = Counter((record.kind, record.ending) for record in records)
    return {kind: {ending: n for (of, ending), n in sorted(counts.items()) if of == kind} for kind in KINDS}


def main() -> None:
    """Run the cases, and print a table and the faults."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="cases")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no case begins after that")
    parser.add_argument("--seed", type=int, default=0, help="of all cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument(
        "--kinds", nargs="+", choices=tuple(KINDS), default=tuple(KINDS), help="all by default"
    )
    parser.add_argument("--workers", type=int, default=2, help="processes, each of about one core and 1 GB")
    parser.add_argument("--json", action="store_true", help="print one JSON object, the rest on stderr")
    options = parser.parse_args()
    stream = sys.stderr if options.json else sys.stdout
    began, records = time.perf_counter(), []
    cases = run_all(options.count, options.seed, tuple(options.kinds), options.first, options.workers)
    for record in cases:
        records.append(record)
        if record.ending in FAULTS or (record.ending == "refused" and not record.mutation):
            print(*record, sep="  ", file=stream, flush=True)
        if len(records) % EVERY == 0:
            print(f"{time.perf_counter() - began:5.0f} s  {len(records)} cases", file=stream, flush=True)
        if time.perf_counter() - began > options.seconds:
            break
    found = summary(records, time.perf_counter() - began)
    if options.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        if name != "cases":
            print(f"{name:<24} {value}")
    raise SystemExit(1 if any(found["faults"].values()) else 0)


if __name__ == "__main__":
    main()
