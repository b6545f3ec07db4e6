"""A trajectory as flat arrays over time, as planned and as integrated again: the data of the histories."""

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxscp.corridor.polytopes import Corridor
from jaxscp.landing.mission import Ellipsoids
from jaxscp.landing.places import leg_of, polytope_of
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.scenario import LandingScenario
from jaxscp.solver.solution import Solution

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
    """The plan's controls integrated again from the start, densely between the nodes.

    Raises:
        TypeError: if the scenario is no landing.
    """
    if not isinstance(scenario, LandingScenario):
        raise TypeError(
            f"scenario: expected a LandingScenario, got a {type(scenario).__name__}. They show landings; of a "
            "problem of your own, plot solution.trajectory.sample(rate=100)."
        )
    parts = _rollout(scenario, solution, samples)
    time, state, control = (np.asarray(v).reshape(-1, *v.shape[2:]) for v in parts)
    cell = np.asarray(polytope_of(solution.context))
    return Curves(time, state, control, np.repeat(cell, samples))


def planned(solution: Solution) -> Curves:
    """The plan at its nodes."""
    path = solution.trajectory
    cell = np.asarray(polytope_of(solution.context))
    return Curves(
        np.asarray(path.time), np.asarray(path.state), np.asarray(path.control), np.append(cell, cell[-1])
    )


@eqx.filter_jit
def _rollout(scenario: LandingScenario, solution: Solution, samples: int) -> tuple[jax.Array, ...]:
    """Times, states and controls, each (intervals, samples, ...)."""
    path = solution.rollout(landing_problem(scenario, leg_of(solution.context)), samples)
    return path.time, path.state, path.control


def corridor_margin(corridor: Corridor, curves: Curves) -> Array:
    """Distance in m from each point to the nearest face of the polytope in force; negative outside it.

    It jumps where the polytope changes. ``union_margin`` does not.

    Args:
        corridor: polytopes.
        curves: points, with the polytope of each.
    """
    return np.take_along_axis(_depths(corridor, curves), curves.polytope[:, None], axis=1)[:, 0]


def union_margin(corridor: Corridor, curves: Curves) -> Array:
    """Clearance to the union of all polytopes, (points,), m: the largest of the distances to each one's faces.

    A point this deep in one polytope is at least this far from every obstacle side of the union. It is continuous in
    the point; negative outside all polytopes.

    Args:
        corridor: polytopes.
        curves: points.
    """
    return np.max(_depths(corridor, curves), axis=1)


def zone_margin(zones: Ellipsoids, curves: Curves) -> Array:
    """Clearance to the nearest ellipsoid, (points,), m; negative inside.

    For a ball this is the distance. For an ellipsoid, (|shape (p - centre)| - 1) times its least semi-axis: a lower
    bound of the distance.

    Args:
        zones: ellipsoids.
        curves: points.
    """
    shapes = np.asarray(zones.shapes)
    from_centre = curves.state[:, None, :3] - np.asarray(zones.centres)
    level = np.linalg.norm(np.einsum("zij,pzj->pzi", shapes, from_centre), axis=2)
    least = 1.0 / np.linalg.norm(shapes, ord=2, axis=(1, 2))
    return np.min((level - 1.0) * least, axis=1, initial=np.inf)


def _depths(corridor: Corridor, curves: Curves) -> Array:
    """Distance of every point to the nearest face of every polytope, (points, polytopes)."""
    corridor = corridor.with_unit_normals()
    normals, offsets = np.asarray(corridor.normals), np.asarray(corridor.offsets)
    depth = offsets - np.einsum("kfc,pc->pkf", normals, curves.state[:, :3])
    used = np.linalg.norm(normals, axis=2) > 1e-9
    return np.min(np.where(used, depth, np.inf), axis=2)
