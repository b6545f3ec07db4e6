"""How an iteration of the paper's mode grows with the nodes and with the faces of a polytope."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks.speed.timing import least_seconds
from jaxscp import SCP, LandingScenario, Planner
from jaxscp.scenarios import platform_to_platform

NODES, FACES = (15, 30, 60, 120, 240), (6, 12, 18, 24)
APART = 0.05  # m between the parallel faces that more faces stand for


def run(echo: Callable[[str], None]) -> dict[str, Any]:
    """Case 1 at every size."""
    scenario = platform_to_platform()
    echo(
        f"{'':12}{'iterations':>11}{'conic steps':>13}{'ms an iteration':>17}{'ms a conic step':>17}{'MiB':>7}"
    )
    by_nodes = {n: measure(f"{n} nodes", scenario, n, echo) for n in NODES}
    by_faces = {f: measure(f"{f} faces", with_faces(scenario, f), 30, echo) for f in FACES}
    per_iteration = {n: row["ms_per_iteration"] for n, row in by_nodes.items()}
    return {
        "ms_per_iteration": per_iteration[30],
        "scaling_240_over_30": per_iteration[240] / per_iteration[30],
        "by_nodes": by_nodes,
        "by_faces": by_faces,
    }


def measure(name: str, scenario: LandingScenario, nodes: int, echo: Callable[[str], None]) -> dict[str, Any]:
    """Time and memory of the iterations, guess and certificate left out."""
    planner = Planner(nodes=nodes, method=SCP())
    problem, z, _ = jax.jit(planner.setup)(scenario)
    compiled = jax.jit(planner.method.run).lower(problem, z).compile()
    state = compiled(problem, z)
    iterations, steps = int(state.iterations), int(jnp.sum(state.history.conic_iterations))
    seconds = least_seconds(lambda: compiled(problem, z))
    row = {
        "iterations": iterations,
        "conic_newton_steps": steps,
        "ms_per_iteration": 1e3 * seconds / iterations,
        "ms_per_conic_step": 1e3 * seconds / steps,
        "bytes": memory(compiled),
    }
    echo(
        f"{name:12}{iterations:11d}{steps:13d}{row['ms_per_iteration']:17.2f}{row['ms_per_conic_step']:17.3f}"
        f"{row['bytes'] / 2**20:7.1f}"
    )
    return row


def memory(compiled: Any) -> int:
    """Bytes that a compiled program needs for arguments, results and what lies between."""
    sizes = compiled.memory_analysis()
    return sizes.argument_size_in_bytes + sizes.output_size_in_bytes + sizes.temp_size_in_bytes


def with_faces(scenario: LandingScenario, faces: int) -> LandingScenario:
    """The same corridor with as many faces a polytope: copies of those it has, each a little further out."""
    normals, offsets = scenario.corridor.normals, scenario.corridor.offsets
    sheets = range(faces // offsets.shape[1])
    more = (
        jnp.concatenate([normals for _ in sheets], axis=1),
        jnp.concatenate([offsets + APART * k for k in sheets], axis=1),
    )
    return eqx.tree_at(lambda s: (s.corridor.normals, s.corridor.offsets), scenario, more)
