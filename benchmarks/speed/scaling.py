"""Time of an iteration of the paper's mode by number of nodes and of faces a polytope."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks.speed.timing import least_in_turns
from jaxscp import PTR, LandingScenario, Planner
from jaxscp.landing.scenarios import platform_to_platform
from jaxscp.problem.scaled_time import ScaledTimeProblem

NODES, FACES = (15, 30, 60, 120, 240), (6, 12, 18, 24)
STANDARD, TURNS = 30, 12  # nodes; number of solves of each size
FACE_SPACING = 0.05  # m between parallel copies of a face


@dataclass(frozen=True)
class Size:
    """Case 1 compiled at a size: the iterations alone, without guess and certificate."""

    name: str
    compiled: Any
    problem: ScaledTimeProblem
    guess: Any

    @classmethod
    def of(cls, name: str, scenario: LandingScenario, nodes: int) -> "Size":
        """Compile."""
        planner = Planner(nodes=nodes, method=PTR())
        problem, z, _ = jax.jit(planner.pipeline.setup)(scenario)
        return cls(name, jax.jit(planner.method.run).lower(problem, z).compile(), problem, z)

    def solve(self) -> Any:
        """Iterate from the guess to the stop."""
        return self.compiled(self.problem, self.guess)

    def row(self, seconds: float) -> dict[str, Any]:
        """Figures of a solve that took these seconds."""
        state = self.solve()
        iterations, steps = int(state.iterations), int(jnp.sum(state.history.conic_iterations))
        return {
            "iterations": iterations,
            "conic_newton_steps": steps,
            "ms_per_iteration": 1e3 * seconds / iterations,
            "ms_per_conic_step": 1e3 * seconds / steps,
            "bytes": memory(self.compiled),
        }


def run(echo: Callable[[str], None]) -> dict[str, Any]:
    """Figures of Case 1 at every size."""
    scenario = platform_to_platform()
    sizes = [Size.of(f"{n} nodes", scenario, n) for n in NODES]
    sizes += [Size.of(f"{f} faces", with_faces(scenario, f), STANDARD) for f in FACES]
    times = least_in_turns([size.solve for size in sizes], TURNS)
    rows = [size.row(seconds) for size, seconds in zip(sizes, times, strict=True)]
    echo(
        f"{'':12}{'iterations':>11}{'conic steps':>13}{'ms an iteration':>17}{'ms a conic step':>17}{'MiB':>7}"
    )
    for size, row in zip(sizes, rows, strict=True):
        echo(
            f"{size.name:12}{row['iterations']:11d}{row['conic_newton_steps']:13d}{row['ms_per_iteration']:17.2f}"
            f"{row['ms_per_conic_step']:17.3f}{row['bytes'] / 2**20:7.1f}"
        )
    by_nodes = dict(zip(NODES, rows, strict=False))
    return {
        "ms_per_iteration": by_nodes[STANDARD]["ms_per_iteration"],
        "scaling_240_over_30": by_nodes[240]["ms_per_iteration"] / by_nodes[STANDARD]["ms_per_iteration"],
        "by_nodes": by_nodes,
        "by_faces": dict(zip(FACES, rows[len(NODES) :], strict=True)),
    }


def memory(compiled: Any) -> int:
    """Bytes of a compiled program for arguments, results and temporary arrays."""
    sizes = compiled.memory_analysis()
    return sizes.argument_size_in_bytes + sizes.output_size_in_bytes + sizes.temp_size_in_bytes


def with_faces(scenario: LandingScenario, faces: int) -> LandingScenario:
    """The same corridor with more faces a polytope: copies of the faces, each a little further out."""
    normals, offsets = scenario.corridor.normals, scenario.corridor.offsets
    sheets = range(faces // offsets.shape[1])
    more = (
        jnp.concatenate([normals for _ in sheets], axis=1),
        jnp.concatenate([offsets + FACE_SPACING * k for k in sheets], axis=1),
    )
    return eqx.tree_at(lambda s: (s.corridor.normals, s.corridor.offsets), scenario, more)
