"""Sweeps: instances a second, time outside the planner, memory, resumption, scaling to two processes, and coverage.

    python -m benchmarks.sweeps [--json] [--count N] [--mode default|paper] [--chunk N] [--gpu | --long]

A landing whose mass, thrust and goal scatter (Case 1, 30 nodes). Compilation is not counted: a first, small sweep fills
the cache of programs and warms each process that is measured. With ``--gpu``, each chunk is one batch; only the rate,
on one device and on all, the time outside the planner and memory are measured. With ``--long``, one sweep by two
processes: its rate, and the memory of all its processes after each tenth.
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
import psutil  # noqa: E402

import jaxscp  # noqa: E402
from jaxscp import monte_carlo as mc  # noqa: E402
from jaxscp.cli.requests import MODES  # noqa: E402

PROBABILITIES = (0.5, 0.9, 0.99)
CASES, SIMULATED, WIDTH = 1000, 20_000, 0.1
PAIR = 2


def study(count: int, mode: str) -> mc.Study:
    """Case 1 with three parameters."""
    parameters = [
        mc.Parameter(lambda s: s.airframe.body.mass, mc.Normal(0.928, 0.05), "mass", "kg"),
        mc.Parameter(lambda s: s.airframe.thrust_max, mc.Uniform(0.7, 1.0), "thrust", change=mc.Scale()),
        mc.Parameter(lambda s: s.goal.position, mc.Normal(0.0, 0.1), "goal_x", "m", index=0, change=mc.Add()),
    ]
    scenario = jaxscp.scenarios.platform_to_platform()
    return mc.Study(MODES[mode](30), scenario, parameters, mc.Independent(count, seed=1))


class Clock(mc.Silent):
    """Notes when each chunk ended."""

    def __init__(self):
        self.times: list[float] = []
        self.cases: list[int] = []

    def update(self, snapshot: mc.Snapshot) -> None:
        """See ``Progress``."""
        self.times.append(time.perf_counter())
        self.cases.append(snapshot.done)


class Memory(Clock):
    """Notes also the resident memory of this process and its workers, MB."""

    def __init__(self):
        super().__init__()
        self.resident: list[float] = []

    def update(self, snapshot: mc.Snapshot) -> None:
        """See ``Progress``."""
        super().update(snapshot)
        this = psutil.Process()
        self.resident.append(
            sum(p.memory_info().rss for p in (this, *this.children(recursive=True))) / 1024.0**2
        )


def rate(
    planned: mc.Study, folder: Path, engine: mc.Engine, chunk: int, skip: int, clock: Clock | None = None
) -> tuple[float, mc.Sweep]:
    """Cases a second between the end of the first chunks, which compile, and the end of the last one."""
    clock = clock or Clock()
    found = mc.sweep(planned, folder, engine=engine, progress=clock, chunk=chunk)
    seconds = clock.times[-1] - clock.times[skip - 1]
    return (clock.cases[-1] - clock.cases[skip - 1]) / seconds, found


def overhead(found: mc.Sweep) -> float:
    """Share of the time of chunks after the first one that was not spent in the planner."""
    about = [found.store.read(f"done/{i:06d}.json") or {} for i in found.store.done()[1:]]
    whole, busy = (sum(facts[name] for facts in about) for name in ("seconds", "busy"))
    return 1.0 - busy / whole


def resumed_equally(planned: mc.Study, whole: mc.Sweep, folder: Path, chunk: int) -> bool:
    """Whether a sweep that is ended half-way and continued has the bits of an uninterrupted one."""
    mc.sweep(planned, folder, stop=(mc.Budget(1e-9),), chunk=chunk)
    again = mc.sweep(planned, folder, chunk=chunk)
    return all(
        np.array_equal(again.values(n), whole.values(n), equal_nan=True)
        for n in whole.results
        if n != "status"
    )


def coverage_worst() -> tuple[float, list[dict[str, Any]]]:
    """The coverage that is furthest from 95 %, and all of them."""
    rows = []
    for rule in (None, mc.NarrowShare(WIDTH)):
        for p in PROBABILITIES:
            share, cases = mc.simulated_coverage(p, CASES, rule, SIMULATED)
            rows.append(
                {"probability": p, "stop_rule": rule is not None, "coverage": share, "mean_cases": cases}
            )
    return max((row["coverage"] for row in rows), key=lambda share: abs(share - 0.95)), rows


def measure(count: int, mode: str, chunk: int, folder: Path) -> dict[str, Any]:
    """All figures."""
    jaxscp.use_cache(folder / "cache")
    planned, few = study(count, mode), study(min(count, 3 * chunk), mode)
    one, whole = rate(planned, folder / "one", mc.InProcess(mc.OneByOne(1)), chunk, 1)
    memory = peak_memory_mb()
    single, _ = rate(planned, folder / "single", mc.Processes(1, mc.OneByOne(1)), chunk, 1)
    both, two = rate(planned, folder / "two", mc.Processes(PAIR, mc.OneByOne(1)), chunk, PAIR)
    small = mc.sweep(few, folder / "few", chunk=chunk)
    worst, rows = coverage_worst()
    return {
        "count": count,
        "mode": mode,
        "chunk": chunk,
        "instances_per_s": max(one, both),
        "instances_per_s_one_process": one,
        "instances_per_s_one_pinned_process": single,
        "instances_per_s_two_processes": both,
        "overhead_share": overhead(whole),
        "peak_memory_mb": memory,
        "resume_equal": resumed_equally(few, small, folder / "resumed", chunk)
        and all(
            np.array_equal(two.values(n), whole.values(n), equal_nan=True) for n in ("cost", "final_time")
        ),
        "scaling_2": both / single,
        "coverage_worst": worst,
        "coverage": rows,
        "statuses": mc.summarise(whole, resamples=0).statuses,
    }


def measure_batches(count: int, mode: str, chunk: int, folder: Path) -> dict[str, Any]:
    """Figures of a sweep whose chunks are batches on one device; where there are several, also the rate on all."""
    jaxscp.use_cache(folder / "cache")
    planned, devices = study(count, mode), tuple(jax.devices())
    of_all = chunk * len(devices)
    if count < 2 * of_all:
        sys.exit(f"--count: needs two chunks on {len(devices)} devices, {2 * of_all} cases at least")
    found, whole = rate(planned, folder / "sweep", mc.InProcess(mc.Together(chunk)), chunk, 1)
    device, several = devices[0], {}
    host_memory, device_memory = peak_memory_mb(), (device.memory_stats() or {}).get("peak_bytes_in_use", 0)
    if len(devices) > 1:
        shared = mc.InProcess(mc.Together(of_all, devices))
        together, _ = rate(planned, folder / "shared", shared, of_all, 1)
        several = {f"instances_per_s_{len(devices)}_devices": together, "devices_over_one": together / found}
    return {
        "count": count,
        "mode": mode,
        "chunk": chunk,
        "device": device.device_kind,
        "instances_per_s": found,
        **several,
        "overhead_share": overhead(whole),
        "peak_memory_mb": host_memory,
        "peak_device_memory_mb": device_memory / 1024.0**2,
        "statuses": mc.summarise(whole, resamples=0).statuses,
    }


def measure_long(count: int, mode: str, chunk: int, folder: Path) -> dict[str, Any]:
    """Figures of one sweep by two processes; memory after each tenth."""
    jaxscp.use_cache(folder / "cache")
    planned, clock = study(count, mode), Memory()
    both, found = rate(planned, folder / "sweep", mc.Processes(PAIR, mc.OneByOne(1)), chunk, PAIR, clock)
    tenths = np.searchsorted(clock.cases, count * np.arange(1, 11) / 10)
    return {
        "count": count,
        "mode": mode,
        "chunk": chunk,
        "instances_per_s": both,
        "overhead_share": overhead(found),
        "memory_mb_by_tenth": [round(clock.resident[i]) for i in tenths],
        "statuses": mc.summarise(found, resamples=0).statuses,
    }


def peak_memory_mb() -> float:
    """Largest resident memory of this process, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0 if sys.platform == "linux" else 1024.0**2)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--count", type=int, default=400, help="instances of a sweep")
    parser.add_argument("--mode", choices=list(MODES), default="default")
    parser.add_argument("--chunk", type=int, default=50)
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--gpu", action="store_true", help="each chunk as one batch on one device, then on all"
    )
    which.add_argument("--long", action="store_true", help="one sweep by two processes, and its memory")
    asked = parser.parse_args()
    if asked.long and asked.count < PAIR * asked.chunk:
        parser.error(f"--long: {PAIR} processes need {PAIR} chunks, {PAIR * asked.chunk} instances or more")
    measured = measure_batches if asked.gpu else measure_long if asked.long else measure
    with tempfile.TemporaryDirectory() as folder:
        found = measured(asked.count, asked.mode, asked.chunk, Path(folder))
    if asked.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:36} {value}")


if __name__ == "__main__":
    main()
