"""Whole missions, indoors and outdoors: landings, collisions, touch-downs, and the time that they take.

Each flight starts on the carrier's deck, flies to a goal through random obstacles, returns and lands. Seeds are 0 to
N - 1. Mass, inertia, thrust, suction, wind and the deck's speed vary. The assessment uses the truth. Shares are of the
flights whose world has a route by a search on the true obstacles; each has its 95 % interval (Wilson).

    python -m benchmarks.missions [--json] [--flights 20] [--first SEED] [--workers 2] [--slots 8] [--rows FILE] [--gpu]

Each process flies ``--slots`` flights side by side. With ``--gpu``, one batch of as many slots flies on the device for
each field, and the processes plan.

A flight can be flown again alone: ``jaxscp mission indoor --seed SEED --video flight.gif``.
"""

import argparse
import json
import math
import os
import tempfile
import time
import warnings
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any

import numpy as np

FIELDS = "indoor", "outdoor"
TICKS = 300  # of the controller, timed
_SPACING = 0.15  # m between points of true obstacles
_CELL = 0.2  # m, of the route search: finer ones take minutes in a field


def row_of(mission) -> dict[str, Any]:
    """One flight as a row."""
    outcome = vars(mission.outcome)
    errors = mission.tracking_errors()
    return outcome | {
        "seed": mission.request.seed,
        "field": mission.request.field,
        "route": outcome["landed"] or has_route(mission.case),
        "landed": mission.accomplished,
        "tracking_rmse": float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else None,
        "aborts": list(mission.commander.aborts),
    }


def has_route(case) -> bool:
    """Whether a search finds a way from the start to the goal among the true obstacles, inflated by the hull."""
    from jaxscp.corridor import PointCloud, find_route
    from jaxscp.corridor.route import Route
    from jaxscp.mission.outcome import HULL

    start = np.array(case.field.home) + np.array([0.0, 0.0, 1.2])
    limits = {
        "lower": np.array(case.field.lower),
        "upper": np.array(case.field.upper),
        "clearance": 0.05,
        "cell": _CELL,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = find_route(
                PointCloud.of(surface(case.scene)), start, np.asarray(case.goal), HULL, **limits
            )
        except ValueError:
            return False
    return isinstance(found, Route)


def surface(scene) -> np.ndarray:
    """Points on the true obstacles' sides."""
    parts = []
    for centre, half in zip(np.asarray(scene.centres), np.asarray(scene.halves), strict=True):
        if half.max() > 4.0:
            continue  # walls are limits of the search
        axes = [np.arange(-h, h + _SPACING, _SPACING).clip(-h, h) for h in half]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        parts.append(centre + grid[np.any(np.isclose(np.abs(grid), half), axis=1)])
    for (x, y), radius, height in zip(
        *map(np.asarray, (scene.axes, scene.radii, scene.heights)), strict=True
    ):
        angle = np.linspace(0.0, 2.0 * np.pi, max(8, int(2.0 * np.pi * radius / _SPACING)), endpoint=False)
        z, a = (v.ravel() for v in np.meshgrid(np.arange(0.0, height, _SPACING), angle))
        parts.append(np.stack([x + radius * np.cos(a), y + radius * np.sin(a), z], axis=1))
    return np.concatenate(parts)


def controller_times() -> tuple[float, float]:
    """Median and 99th percentile of one tick of the mission's controller, ms, on one core."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from jaxscp.mission.member import nominal_pilot

    pilot = nominal_pilot()
    level = jnp.zeros(13).at[6].set(1.0)
    control = jax.jit(lambda memory, estimate, now: pilot.nmpc(pilot.still, memory, estimate, now))
    memory, found = pilot.nmpc.init(pilot.still, level), []
    for number in range(TICKS + 20):
        estimate = level.at[0].set(0.3 * math.sin(0.1 * number))
        began = time.perf_counter()
        memory, _ = jax.block_until_ready(control(memory, estimate, jnp.asarray(0.01 * number)))
        found.append(1e3 * (time.perf_counter() - began))
    return float(np.median(found[20:])), float(np.quantile(found[20:], 0.99))


def factor_alone(seed: int) -> float:
    """Seconds of one flight for each second that it takes, alone on the CPU; compiled before."""
    import jax

    from jaxscp.mission import run_mission

    with jax.default_device(jax.devices("cpu")[0]):
        run_mission("indoor", seed)
        began = time.perf_counter()
        mission = run_mission("indoor", seed)
    return mission.outcome.duration / (time.perf_counter() - began)


def summary(rows: list[dict[str, Any]], times: tuple[float, float]) -> dict[str, Any]:
    """The figures of all flights; None without flights. Aborted: the flight does not end landed."""
    from jaxscp.monte_carlo.intervals import wilson

    found: dict[str, Any] = {"flights": len(rows)}
    for name in FIELDS:
        chosen = [row for row in rows if row["field"] == name and row["route"]]
        shares = {
            "landed": [row["landed"] and row["attempts"] <= 2 for row in chosen],
            "landed_first_approach": [row["landed"] and row["attempts"] == 1 for row in chosen],
            "aborted": [row["end"] != "landed" for row in chosen],
        }
        for key, flags in shares.items():
            interval = wilson(sum(flags), len(flags))
            found[f"{key}_{name}"] = interval.estimate
            found[f"{key}_{name}_interval"] = [interval.lower, interval.upper]
        prefix = "" if name == "indoor" else "outdoor_"
        errors = [row["touchdown"] for row in chosen if math.isfinite(row["touchdown"])]
        found[f"{prefix}touchdown_median_m"] = quantile(errors, 0.5)
        found[f"{prefix}touchdown_p95_m"] = quantile(errors, 0.95)
    collisions = sum(row["collision"] for row in rows)
    found["collisions"] = collisions
    found["collisions_upper_bound"] = wilson(collisions, len(rows)).upper
    speeds = [row["vertical_speed"] for row in rows if math.isfinite(row["vertical_speed"])]
    found["vertical_speed_p95"] = quantile(speeds, 0.95)
    found["nmpc_ms_median"], found["nmpc_ms_p99"] = times
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in found.items()}


def quantile(values: list[float], share: float) -> float | None:
    """A quantile, or None without values."""
    return float(np.quantile(values, share)) if values else None


def requests(name: str, seeds: Iterable[int], wind: float | None) -> list[Any]:
    """Missions of a field."""
    from jaxscp.mission import Choices, Request

    return [Request(name, seed, Choices(wind=wind if name == "outdoor" else None)) for seed in seeds]


def fly_share(name: str, seeds: list[int], slots: int, wind: float | None, file: str) -> None:
    """Fly missions side by side in this process. Each row is written when its flight ends."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from jaxscp.mission import Crew, run_missions

    write(run_missions(requests(name, seeds, wind), slots, Crew(row_of)), file, wind)


def write(rows: Iterable[dict[str, Any]], file: str, wind: float | None) -> None:
    """Append rows as they come. Several processes may: a line is one write."""
    for row in rows:
        with open(file, "a") as out:
            out.write(json.dumps(row | {"asked_wind": wind}) + "\n")


def fly_on_processes(tasks: dict[str, list[int]], asked: argparse.Namespace) -> None:
    """Each process has a core, and flies a share of each field side by side."""
    from jaxscp.monte_carlo import Processes

    shares = [
        (name, seeds[number :: asked.workers])
        for name, seeds in tasks.items()
        for number in range(asked.workers)
    ]
    with Processes(asked.workers).opened() as pool:
        jobs = [
            pool.executor.submit(fly_share, name, seeds, asked.slots, asked.wind, asked.rows)
            for name, seeds in shares
            if seeds
        ]
        for job in as_completed(jobs):
            job.result()


def fly_on_device(tasks: dict[str, list[int]], asked: argparse.Namespace) -> None:
    """The physics of each field is one batch on JAX's device; its commanders plan in processes.

    The fields take turns: one flies while the other plans.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    from jaxscp.mission import WorkerCrews, run_missions, workers

    with workers(asked.workers) as pool, ThreadPoolExecutor(len(tasks)) as threads:
        jobs = []
        for name, seeds in tasks.items():
            flown = run_missions(requests(name, seeds, asked.wind), asked.slots, WorkerCrews(pool, row_of))
            jobs.append(threads.submit(write, flown, asked.rows, asked.wind))
        for job in jobs:
            job.result()


def fly_all(asked: argparse.Namespace) -> tuple[list[dict[str, Any]], float]:
    """Rows of all flights, and seconds of flight for each second that they took.

    Rows in the file are not flown again, and do not count for the time. Those that were flown in another wind stay in
    the file, and count as not flown.
    """
    names = FIELDS if asked.field is None else (asked.field,)
    seeds = range(asked.first, asked.first + asked.flights)
    done = {(row["field"], row["seed"]) for row in stored(asked)}
    tasks = {name: [seed for seed in seeds if (name, seed) not in done] for name in names}
    began = time.perf_counter()
    (fly_on_device if asked.gpu else fly_on_processes)(tasks, asked)
    seconds = time.perf_counter() - began
    chosen = [row for row in stored(asked) if row["field"] in names and row["seed"] in seeds]
    flown = sum(row["duration"] for row in chosen if (row["field"], row["seed"]) not in done)
    return sorted(chosen, key=lambda row: (row["field"], row["seed"])), flown / seconds


def stored(asked: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of the file that were flown in the wind that is asked for."""
    if not os.path.exists(asked.rows):
        return []
    with open(asked.rows) as before:
        rows = [json.loads(line) for line in before]
    return [row for row in rows if row["asked_wind"] == asked.wind or row["field"] == "indoor"]


def main() -> None:
    """Fly, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--flights", type=int, default=200, help="in each field")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--field", choices=FIELDS, help="one field alone")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--slots", type=int, default=8, help="flights side by side in a batch")
    parser.add_argument(
        "--rows", metavar="FILE", help="append a JSON line a flight; those there are not repeated"
    )
    parser.add_argument("--wind", type=float, help="mean wind outdoors in m/s instead of 0 to 8")
    parser.add_argument(
        "--gpu", action="store_true", help="physics of all slots on JAX's device, plans on the workers"
    )
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        asked.rows = asked.rows or os.path.join(folder, "rows.jsonl")
        rows, factor = fly_all(asked)
    found = summary(rows, controller_times())
    found |= {"realtime_factor_one": factor_alone(asked.first), "realtime_factor_batch": factor}
    if asked.json:
        print(json.dumps(found))
    else:
        for key, value in found.items():
            print(f"{key:36} {value}")
        failed = [f"{r['field']} {r['seed']}: {r['end']}, {r['aborts']}" for r in rows if not r["landed"]]
        print("not landed:", *(failed or ["none"]), sep="\n  ")


if __name__ == "__main__":
    main()
