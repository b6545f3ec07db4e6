"""The interior point alone, on subproblems of real plans: how many of them, and Newton steps, a device makes a second.

The subproblems are recorded on the host's CPU, from flights of ``batches``; then as many of them at once as are asked
for are solved on JAX's default device, each as accurately and from as near as in its plan.
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
from jaxscp.scp.nodal_subproblem import convexify

FLIGHTS = 64  # distinct ones; more lanes have the same again
SUBPROBLEMS = 5  # of a plan


def run(echo: Callable[[str], None], nodes: int, lanes: int) -> dict[str, Any]:
    """The first subproblems of a plan, one after another, and all of them together."""
    method = PTR()
    solve = jax.jit(jax.vmap(method.conic.iterate))
    device = jax.devices()[0]
    rows = []
    for k, given in enumerate(recorded(method, nodes, min(lanes, FLIGHTS))):
        batch = jax.device_put(jax.tree.map(lambda v: _repeated(v, lanes), given), device)
        ended = jax.block_until_ready(solve(*batch))
        seconds = min(elapsed(lambda batch=batch: solve(*batch)) for _ in range(REPEATS))
        rows.append({"seconds": seconds, "steps": int(np.sum(ended.iterations)), "lanes": lanes})
        echo(_line(f"{device.device_kind}, {lanes} at once, subproblem {k + 1}", rows[-1:]))
    echo(_line("all", rows))
    return {
        "subproblems_per_s": _total(rows, "lanes") / _total(rows, "seconds"),
        "interior_point_alone": rows,
    }


def recorded(method: PTR, nodes: int, flights: int) -> list[Any]:
    """What the interior point is given of the subproblems of as many plans: programs, accuracies, and points
    that are thought near; on the host."""
    planner = Planner(nodes=nodes, method=method)

    def given(problem, state):
        program, _ = convexify(problem, state.z, state.flow, method.trust_region, method.virtual_weight)
        return (
            program,
            jnp.maximum(method.conic.tolerance, method.accuracy(state)),
            WarmStart(state.z, state.prices),
        )

    with jax.default_device(jax.devices("cpu")[0]):
        problem, z, _ = jax.jit(jax.vmap(planner.setup))(instances(jax.random.key(7), flights))
        state = jax.jit(jax.vmap(method.init))(problem, z)
        record, step = (jax.jit(jax.vmap(function)) for function in (given, method.step))
        found = []
        for _ in range(SUBPROBLEMS):
            found.append(jax.tree.map(np.asarray, record(problem, state)))
            state = step(problem, state)
    return found


def _repeated(v: np.ndarray, lanes: int) -> np.ndarray:
    return np.resize(v, (lanes, *v.shape[1:]))  # runs through the flights again and again


def _total(rows: list[dict[str, Any]], key: str) -> float:
    return sum(row[key] for row in rows)


def _line(name: str, rows: list[dict[str, Any]]) -> str:
    seconds, steps, lanes = (_total(rows, key) for key in ("seconds", "steps", "lanes"))
    return (
        f"{name}: {1e3 * seconds:.1f} ms, {steps / lanes:.1f} Newton steps each, {steps / seconds:.0f} of them "
        f"and {lanes / seconds:.0f} subproblems a second"
    )
