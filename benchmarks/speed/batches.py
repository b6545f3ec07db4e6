"""Whole plans at once: distinct random corridor instances in the paper's mode, by batch size.

Starts, goals, headings, masses, thrust limits and every face of the corridor differ from instance to instance. This
part needs only jaxscp and runs on a machine without the rivals. Each line is printed at once.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks.speed.scaling import memory
from benchmarks.speed.timing import elapsed
from jaxscp import PTR, LandingScenario, Planner, Solution, Status
from jaxscp.landing.scenarios import platform_to_platform
from tests.support.random_instances import bare, random_instances

REPEATS = 3  # of a batch; the least time counts
WALLS = 0.15  # m: largest outward shift of a face of the corridor


def instances(key: Any, count: int) -> LandingScenario:
    """A batch of distinct feasible scenarios."""
    keys = jax.random.split(key)
    batch = random_instances(keys[0], count, lambda: bare(platform_to_platform(), 0.0))
    offsets = batch.corridor.offsets
    back = jax.random.uniform(keys[1], offsets.shape, offsets.dtype, maxval=WALLS)
    return eqx.tree_at(lambda s: s.corridor.offsets, batch, offsets + back)


def sizes_up_to(lanes: int) -> list[int]:
    """The batch sizes 1, 16, 256, 4096 and 16384 below the given one, and the given one."""
    return [size for size in (1, 16, 256, 4096, 16384) if size < lanes] + [lanes]


def run(echo: Callable[[str], None], nodes: int, lanes: int, total: int) -> dict[str, Any]:
    """Figures of the given batch size, of ``total`` instances by chunks, then of smaller batches."""
    device = jax.devices()[0]
    echo(f"{device.device_kind}: the paper's mode, {nodes} nodes, float64; every instance another corridor")
    planner = Planner(nodes=nodes, method=PTR())
    main, compiled = at_once(planner, lanes, echo)
    chunked = by_chunks(compiled, lanes, total, echo) if total > lanes else None
    rows = {size: at_once(planner, size, echo)[0] for size in sizes_up_to(lanes)[:-1]}
    best = chunked or main
    on_host = host_seconds(planner, echo) if device.platform != "cpu" else None
    return {
        "device": device.device_kind,
        "lanes": lanes,
        "trajectories_per_s": main["trajectories_per_s"],
        "subproblems_of_plans_per_s": main["subproblems_per_s"],
        "conic_newton_steps_per_s": main["conic_newton_steps_per_s"],
        "converged_share": best["converged_share"],
        "batch_of_one_ms": 1e3 * rows[1]["seconds"] if 1 in rows else None,
        "one_on_host_ms": 1e3 * on_host if on_host else None,
        "bytes_per_instance": main["bytes_per_instance"],
        "by_size": rows | {lanes: main},
        "chunked": chunked,
    }


def at_once(planner: Planner, size: int, echo: Callable[[str], None]) -> tuple[dict[str, Any], Any]:
    """Compile for a batch size and plan one batch; returns the row and the program."""
    batch = instances(jax.random.key(size), size)
    began = time.perf_counter()
    compiled = planner.compile(jax.tree.map(lambda v: v[0], batch), lanes=size)
    compile_seconds = time.perf_counter() - began
    held = max(memory(part) for part in (compiled.setup, compiled.solve, compiled.conclude)) / size
    echo(f"{size} at once: compiled in {compile_seconds:.0f} s, {held / 2**10:.0f} KiB an instance")
    solutions = jax.block_until_ready(compiled(batch))
    row = figures(solutions, min(elapsed(lambda: compiled(batch)) for _ in range(REPEATS)))
    row |= {"compile_seconds": compile_seconds, "bytes_per_instance": held}
    echo(_line(f"{size} at once", row))
    return row, compiled


def host_seconds(planner: Planner, echo: Callable[[str], None]) -> float:
    """Seconds of one plan on the host's CPU, for a machine with a GPU."""
    with jax.default_device(jax.devices("cpu")[0]):
        one = jax.tree.map(lambda v: v[0], instances(jax.random.key(1), 1))
        plan = jax.jit(planner)
        jax.block_until_ready(plan(one))
        seconds = min(elapsed(lambda: plan(one)) for _ in range(10 * REPEATS))
    echo(f"one on the host's CPU: {1e3 * seconds:.1f} ms")
    return seconds


def by_chunks(compiled: Any, lanes: int, total: int, echo: Callable[[str], None]) -> dict[str, Any]:
    """Figures of many instances, by chunks of the compiled size; drawing the instances is not timed."""
    chunks = [instances(jax.random.key(100 + i), lanes) for i in range(-(-total // lanes))]
    jax.block_until_ready(chunks)
    found: list[Solution] = []
    seconds = elapsed(lambda: found.extend(sweep(compiled, chunks)) or found)
    solutions = jax.tree.map(lambda *parts: np.concatenate([np.asarray(p) for p in parts]), *found)
    row = figures(solutions, seconds)
    echo(_line(f"{row['instances']} by chunks of {lanes}", row))
    return row


def sweep(compiled: Any, chunks: list[LandingScenario]) -> Iterator[Solution]:
    """Solutions of the chunks, in order; each is copied to the host while the next is planned."""
    last = None
    for chunk in chunks:
        found = compiled(chunk)
        if last is not None:
            yield jax.device_get(last)
        last = found
    yield jax.device_get(last)


def figures(solutions: Solution, seconds: float) -> dict[str, Any]:
    """Figures of speed of a batch of plans."""
    iterations, steps = np.asarray(solutions.iterations), np.asarray(solutions.history.conic_iterations)
    return {
        "instances": int(iterations.size),
        "seconds": seconds,
        "trajectories_per_s": iterations.size / seconds,
        "subproblems_per_s": float(np.sum(iterations)) / seconds,
        "conic_newton_steps_per_s": float(np.sum(steps)) / seconds,
        "converged_share": float(np.mean(np.asarray(solutions.status == Status.converged))),
        "iterations_median": float(np.median(iterations)),
        "iterations_most": int(np.max(iterations)),
    }


def _line(name: str, row: dict[str, Any]) -> str:
    return (
        f"{name}: {1e3 * row['seconds']:.1f} ms, {row['trajectories_per_s']:.1f} trajectories/s, "
        f"{row['subproblems_per_s']:.1f} subproblems/s, {row['conic_newton_steps_per_s']:.0f} conic Newton steps/s, "
        f"{row['converged_share']:.1%} converged, {row['iterations_median']:.0f} subproblems a plan "
        f"(most {row['iterations_most']})"
    )
