"""Oracle of converged plans, by SciPy alone: DOP853 from the start that was asked for, and the true obstacles.

Nothing of the package runs here: its arrays are read, and equations 1 to 6 are written again in NumPy.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial import KDTree

SLACK = 2.0  # times the certificate's own tolerances, for the integration here
POSITION, SPEED, RATE, ANGLE = 1e-3, 1e-2, 1e-2, 1.75e-3  # m, m/s, rad/s, rad: of the certificate
RELATIVE = 1e-3  # of a limit
SAMPLES = 40  # an interval
ACCURACY = 1e-8

Box = tuple[np.ndarray, np.ndarray]


class World(NamedTuple):
    """The truth about a place."""

    free: Sequence[Box] = ()
    """Boxes whose union the vehicle's centre must not leave; none: anywhere."""
    margin: float = 0.0
    """m, that the centre keeps from the faces of that union."""
    solid: Sequence[Box] = ()
    """Boxes of matter."""
    least: float = 0.0
    """m, that the centre keeps from matter."""
    points: np.ndarray = np.empty((0, 3))
    """Points of matter."""
    least_points: float = 0.0
    """m, that the centre keeps from these points."""


def faults(scenario: Any, solution: Any, world: World) -> str:
    """Faults of a plan that claims to have converged; empty if there is none."""
    if lost := [str(leaf.shape) for leaf in map(np.asarray, jax.tree.leaves(solution)) if _lost(leaf)]:
        return f"NaN in {len(lost)} arrays"
    path = rollout(scenario, solution)
    found = [*_end(scenario, path[-1]), *_limits(scenario, solution, path), *_places(world, path[:, :3])]
    return "; ".join(found)


def _lost(leaf: np.ndarray) -> bool:
    return leaf.dtype.kind == "f" and bool(np.isnan(leaf).any())


def rollout(scenario: Any, solution: Any, accuracy: float = ACCURACY) -> np.ndarray:
    """States along the planned controls, (samples, 13), from the scenario's own start."""
    body, start = scenario.airframe.body, scenario.start
    mass, inertia = float(body.mass), np.asarray(body.inertia)
    thrust, torque = np.asarray(body.thrust_map), np.asarray(body.torque_map)
    gravity, inverse = np.asarray(body.gravity), np.linalg.inv(inertia)
    control, dilation = np.asarray(solution.trajectory.control), np.asarray(solution.trajectory.dilation)
    width = 1.0 / (len(dilation) - 1)

    def rate(fraction, x, k):
        u = control[k] + fraction * (control[k + 1] - control[k])
        w, (a, b, c, d) = x[10:], x[6:10]
        force = thrust @ u
        pure = np.array([b, c, d])
        turned = force + 2.0 * np.cross(pure, np.cross(pure, force) + a * force)
        spin = 0.5 * np.array([-(pure @ w), *(a * w + np.cross(pure, w))])
        angular = inverse @ (torque @ u - np.cross(w, inertia @ w))
        slope = np.concatenate([x[3:6], turned / mass + gravity, spin, angular])
        return width * (dilation[k] + fraction * (dilation[k + 1] - dilation[k])) * slope

    attitude = np.asarray(start.attitude) / np.linalg.norm(start.attitude)
    x = np.concatenate([start.position, start.velocity, attitude, start.body_rate])
    states = []
    for k in range(len(dilation) - 1):
        done = solve_ivp(
            rate,
            (0.0, 1.0),
            x,
            "DOP853",
            np.linspace(0.0, 1.0, SAMPLES),
            args=(k,),
            rtol=accuracy,
            atol=accuracy,
        )
        if not done.success:
            return np.full((1, 13), np.inf)
        states.append(done.y.T)
        x = done.y[:, -1]
    return np.concatenate(states)


def _end(scenario: Any, last: np.ndarray):
    goal = scenario.goal
    asked = np.asarray(goal.attitude) / np.linalg.norm(goal.attitude)
    angle = 2.0 * np.arccos(np.clip(abs(asked @ last[6:10]) / np.linalg.norm(last[6:10]), 0.0, 1.0))
    rows = (
        ("position", np.linalg.norm(last[:3] - goal.position), POSITION),
        ("velocity", np.linalg.norm(last[3:6] - goal.velocity), SPEED),
        ("body rate", np.linalg.norm(last[10:] - goal.body_rate), RATE),
        ("attitude", angle, ANGLE),
    )
    for name, error, allowed in rows:
        if not error <= SLACK * allowed:
            yield f"final {name} off by {error:.3g}"


def _limits(scenario: Any, solution: Any, path: np.ndarray):
    frame, limits, control = scenario.airframe, scenario.limits, np.asarray(solution.trajectory.control)
    low, high = np.asarray(frame.thrust_min), np.asarray(frame.thrust_max)
    excess = np.maximum(low - control, control - high).max()
    if not excess <= SLACK * RELATIVE * (high - low).max():
        yield f"thrust beyond its limit by {excess:.3g} N"
    speeds = (
        ("speed", np.linalg.norm(path[:, 3:6], axis=1)),
        ("body_rate", np.linalg.norm(path[:, 10:], axis=1)),
    )
    tilt = 2.0 * np.arcsin(np.clip(np.linalg.norm(path[:, 7:9], axis=1), 0.0, 1.0))
    for name, values in (*speeds, ("tilt", tilt)):
        limit = getattr(limits, name)
        if limit is not None and not values.max() <= float(limit) * (1.0 + SLACK * RELATIVE):
            yield f"{name} {values.max():.4g} beyond {float(limit):.4g}"


def _places(world: World, places: np.ndarray):
    if len(world.free):
        depth = np.max([_depth(places, low, high) for low, high in world.free], axis=0).min()
        if not depth >= world.margin - SLACK * POSITION:
            yield f"comes within {depth:.3g} m of the walls, {world.margin:.3g} asked"
    if len(world.solid):
        nearest = min(-_depth(places, low, high).max() for low, high in world.solid)
        if not nearest >= world.least - SLACK * POSITION:
            yield f"comes within {nearest:.3g} m of matter, {world.least:.3g} asked"
    if len(world.points):
        nearest = float(np.min(KDTree(world.points).query(places)[0]))
        if not nearest >= world.least_points - SLACK * POSITION:
            yield f"comes within {nearest:.3g} m of a point, {world.least_points:.3g} asked"


def _depth(places: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Depth in a box; outside, minus the distance to it."""
    outside = np.linalg.norm(np.maximum(np.maximum(low - places, places - high), 0.0), axis=1)
    inside = np.minimum(places - low, high - places).min(axis=1)
    return np.where(outside > 0.0, -outside, inside)
