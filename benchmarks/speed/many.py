"""Many certified optima: distinct random instances in the default mode, from host arrays to host solutions.

On GPUs, ``planner.map`` on one of them, then on all. On a CPU, ``planner.map`` against a plain loop over the compiled
planner, and two more pairs: the compiled ``jax.vmap`` and the loop; ``planner.map`` and two processes at once, each
pinned to one core.
"""

import multiprocessing
import os
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.speed.batches import instances
from benchmarks.speed.timing import elapsed
from jaxscp import LandingScenario, Planner, Status

SIZES = (2, 8, 32, 256)
VMAPPED = 32  # plans of the program by ``jax.vmap``
TURNS = 3  # of small batches; the median of the ratios counts
SMALL = 64
PROCESSES = 2
PATIENCE = 600.0  # s: for a process to compile and to plan


def run(echo: Callable[[str], None], nodes: int, batch_size: int, total: int) -> dict[str, Any]:
    """Figures of the default mode; ``batch_size`` and ``total`` count on a GPU, and ``SIZES`` on a CPU."""
    planner, device = Planner(nodes=nodes), jax.devices()[0]
    echo(f"{device.device_kind}: the default mode, {nodes} nodes; every instance another corridor")
    return _on_cpu(planner, echo) if device.platform == "cpu" else _on_gpu(planner, batch_size, total, echo)


def _on_cpu(planner: Planner, echo: Callable[[str], None]) -> dict[str, Any]:
    batch = instances(jax.random.key(SIZES[-1]), SIZES[-1])
    jax.block_until_ready(planner(part(batch, 0)))
    over_loop = {size: _over_loop(planner, batch, size, echo) for size in SIZES}
    vmapped = _vmapped(planner, batch, echo)
    over_processes, solutions, seconds = _over_processes(planner, batch, echo)
    return vmapped | {
        "batch_over_loop": over_loop,
        "batch_over_processes": over_processes,
        **_rate(solutions, seconds, echo),
    }


def _on_gpu(planner: Planner, size: int, total: int, echo: Callable[[str], None]) -> dict[str, Any]:
    batch = jax.device_get(instances(jax.random.key(total), total))
    compile_s, facts, seconds = _in_batches(planner, batch, size, ())
    found = {"batch_compile_s": compile_s, **_rate(facts, seconds, echo)}
    if len(devices := tuple(jax.devices())) > 1:
        _, facts, shared = _in_batches(planner, batch, size * len(devices), devices)
        _rate(facts, shared, echo)
        echo(f"{len(devices)} devices: {seconds / shared:.2f} times one")
        found["devices_over_one"] = seconds / shared
    return found


def _in_batches(
    planner: Planner, batch: Any, size: int, devices: tuple[Any, ...]
) -> tuple[float, Any, float]:
    """Seconds to compile for these devices and to plan a batch; facts of all plans; and their seconds."""
    first = jax.tree.map(lambda v: v[:size], batch)
    compile_s = elapsed(lambda: planner.map(first, size, devices=devices, keep=_facts))
    began = time.perf_counter()
    facts = planner.map(batch, size, devices=devices, keep=_facts)
    return compile_s, facts, time.perf_counter() - began


def part(batch: LandingScenario, index: int) -> LandingScenario:
    """One scenario of a batch."""
    return jax.tree.map(lambda v: np.asarray(v[index]), batch)


def _facts(solutions: Any) -> tuple[Any, Any]:
    return solutions.status, solutions.cost


def _rate(facts: tuple[Any, Any], seconds: float, echo: Callable[[str], None]) -> dict[str, float]:
    """Converged plans a second, and their share; a plan that the certificate refuses has not converged."""
    converged = np.asarray(facts[0] == Status.converged)
    rate, share = float(np.sum(converged)) / seconds, float(np.mean(converged))
    echo(f"{converged.size} by planner.map: {rate:.1f} certified optima a second, {share:.2%} converged")
    return {"default_trajectories_per_s": rate, "default_converged_share": share}


def _over_loop(planner: Planner, batch: Any, size: int, echo: Callable[[str], None]) -> float:
    """Rate of ``planner.map`` over the rate of a loop of calls, in turns."""
    ones = [part(batch, i) for i in range(size)]
    some = jax.tree.map(lambda v: v[:size], batch)
    loop, mapped = lambda: [jax.device_get(planner(one)) for one in ones], lambda: planner.map(some)
    turns = [elapsed(loop) / elapsed(mapped) for _ in range(TURNS if size <= SMALL else 1)]
    echo(f"{size}: planner.map {np.median(turns):.2f} times a loop")
    return float(np.median(turns))


def _vmapped(planner: Planner, batch: Any, echo: Callable[[str], None]) -> dict[str, float]:
    """Compile time of a program by ``jax.vmap``, and its rate over the rate of a loop."""
    some = jax.tree.map(lambda v: v[:VMAPPED], batch)
    ones = [part(batch, i) for i in range(VMAPPED)]
    began = time.perf_counter()
    compiled = planner.compile(ones[0], VMAPPED)
    seconds = time.perf_counter() - began
    jax.block_until_ready(compiled(some))
    loop = lambda: [jax.device_get(planner(one)) for one in ones]  # noqa: E731
    ratio = float(np.median([elapsed(loop) / elapsed(lambda: compiled(some)) for _ in range(TURNS)]))
    echo(f"{VMAPPED} by jax.vmap: compiled in {seconds:.1f} s, {ratio:.2f} times a loop")
    return {"batch_compile_s": seconds, "vmap_over_loop": ratio}


def _over_processes(
    planner: Planner, batch: Any, echo: Callable[[str], None]
) -> tuple[float, tuple[Any, Any], float]:
    """Rate of ``planner.map`` over the rate of pinned processes; its facts and seconds."""
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(PROCESSES + 1)
    arguments = [(barrier, planner.nodes, i) for i in range(PROCESSES)]
    workers = [context.Process(target=_pinned, args=these, daemon=True) for these in arguments]
    try:
        for worker in workers:
            worker.start()
        barrier.wait(PATIENCE)  # compiled
        began = time.perf_counter()
        barrier.wait(PATIENCE)  # planned
        processes = time.perf_counter() - began
    finally:
        for worker in workers:
            worker.join(PATIENCE)
    planned: list[Any] = []
    seconds = elapsed(lambda: planned.append(planner.map(batch, keep=_facts)) or 0)
    echo(f"{SIZES[-1]}: planner.map {processes / seconds:.2f} times {PROCESSES} pinned processes")
    return processes / seconds, planned[0], seconds


def _pinned(barrier: Any, nodes: int, number: int) -> None:
    """Plan a share of the batch on one core."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, cores[number % len(cores) :: PROCESSES] or cores)
    jax.config.update("jax_enable_x64", True)
    planner, batch = Planner(nodes=nodes), instances(jax.random.key(SIZES[-1]), SIZES[-1])
    ones = [part(batch, i) for i in range(number, SIZES[-1], PROCESSES)]
    jax.block_until_ready(planner(ones[0]))
    barrier.wait()
    for one in ones:
        jax.device_get(planner(one))
    barrier.wait()
