"""Throughput of the interior point alone, on subproblems of real plans: Newton steps and subproblems per second.

The subproblems are recorded on the host's CPU from the instances of ``batches``. A batch of them is then solved on
JAX's default device, with the accuracies and warm starts of the plans.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.speed.batches import REPEATS, instances
from benchmarks.speed.timing import elapsed
from jaxscp import PTR, Planner
from jaxscp.conic.program import WarmStart
from jaxscp.scp.nodal_subproblem import nodal_subproblem

PLANS = 64  # distinct ones; a larger batch repeats them
SUBPROBLEMS = 5  # of a plan


def run(echo: Callable[[str], None], nodes: int, batch_size: int) -> dict[str, Any]:
    """Throughput on the first subproblems of a plan, one after another, and on all of them together."""
    method = PTR()
    solve = jax.jit(jax.vmap(method.conic.iterate))
    device = jax.devices()[0]
    rows = []
    for k, arguments in enumerate(recorded(method, nodes, min(batch_size, PLANS))):
        batch = jax.device_put(jax.tree.map(lambda v: _repeated(v, batch_size), arguments), device)
        result = jax.block_until_ready(solve(*batch))
        seconds = min(elapsed(lambda batch=batch: solve(*batch)) for _ in range(REPEATS))
        rows.append({"seconds": seconds, "steps": int(np.sum(result.iterations)), "batch_size": batch_size})
        echo(_line(f"{device.device_kind}, {batch_size} at once, subproblem {k + 1}", rows[-1:]))
    echo(_line("all", rows))
    return {
        "subproblems_per_s": _total(rows, "batch_size") / _total(rows, "seconds"),
        "interior_point_alone": rows,
    }


def recorded(method: PTR, nodes: int, plans: int) -> list[Any]:
    """Batches of arguments (program, accuracy, warm start) of the interior point, one per iteration, on the host."""
    planner = Planner(nodes=nodes, method=method)

    def arguments(problem, state):
        program, _ = nodal_subproblem(
            problem, state.z, state.flow, method.trust_region, method.virtual_weight
        )
        return (
            program,
            jnp.maximum(method.conic.tolerance, method.forcing_term(state)),
            WarmStart(state.z, state.multipliers),
        )

    with jax.default_device(jax.devices("cpu")[0]):
        problem, z, _ = jax.jit(jax.vmap(planner.pipeline.setup))(instances(jax.random.key(7), plans))
        state = jax.jit(jax.vmap(method.init))(problem, z)
        record, step = (jax.jit(jax.vmap(function)) for function in (arguments, method.step))
        records = []
        for _ in range(SUBPROBLEMS):
            records.append(jax.tree.map(np.asarray, record(problem, state)))
            state = step(problem, state)
    return records


def _repeated(v: np.ndarray, batch_size: int) -> np.ndarray:
    return np.resize(v, (batch_size, *v.shape[1:]))  # repeats the plans


def _total(rows: list[dict[str, Any]], key: str) -> float:
    return sum(row[key] for row in rows)


def _line(name: str, rows: list[dict[str, Any]]) -> str:
    seconds, steps, count = (_total(rows, key) for key in ("seconds", "steps", "batch_size"))
    return (
        f"{name}: {1e3 * seconds:.1f} ms, {steps / count:.1f} Newton steps each, {steps / seconds:.0f} of them "
        f"and {count / seconds:.0f} subproblems a second"
    )
