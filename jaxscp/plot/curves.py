"""A trajectory as flat arrays over time, as planned and as integrated again: the data of the histories."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxscp.corridor.polytopes import Corridor
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.scenario import LandingScenario
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.solver.solution import Solution
from jaxscp.verification.rollout import Rollout, rollout

SAMPLES = 24  # drawn points an interval

Array = np.ndarray


class Curves(NamedTuple):
    """A trajectory as flat arrays over time."""

    time: Float[np.ndarray, "points"]
    """s"""
    state: Float[np.ndarray, "points 13"]
    control: Float[np.ndarray, "points rotors"]
    polytope: Array
    """(points,) index of the corridor polytope in force."""


def integrated(scenario: LandingScenario, solution: Solution, samples: int = SAMPLES) -> Curves:
    """The plan's controls integrated again from the start, densely between the nodes."""
    path = _rollout(scenario, solution, samples)
    flat = jax.tree.map(lambda v: np.asarray(v).reshape(-1, *v.shape[2:]), path)
    return Curves(flat.time, flat.state, flat.control, np.repeat(np.asarray(solution.context), samples))


def planned(solution: Solution) -> Curves:
    """The plan at its nodes."""
    path = solution.trajectory
    cell = np.asarray(solution.context)
    return Curves(
        np.asarray(path.time), np.asarray(path.state), np.asarray(path.control), np.append(cell, cell[-1])
    )


@eqx.filter_jit
def _rollout(scenario: LandingScenario, solution: Solution, samples: int) -> Rollout:
    return rollout(
        over_scaled_time(landing_problem(scenario, solution.context), Continuous()),
        solution.trajectory,
        samples,
    )


def corridor_margin(corridor: Corridor, curves: Curves) -> Array:
    """Distance in m from each point to the nearest face of the polytope in force; negative outside it."""
    normals = np.asarray(corridor.normals)[curves.polytope]
    along = np.einsum("pfc,pc->pf", normals, curves.state[:, :3])
    depth = np.asarray(corridor.offsets)[curves.polytope] - along
    used = np.linalg.norm(normals, axis=2) > 1e-9
    return np.min(np.where(used, depth, np.inf), axis=1)
