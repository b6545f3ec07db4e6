"""Oracle of converged plans, by SciPy alone: DOP853 from the start that was asked for, and the true obstacles.

Nothing of the package runs here: its arrays are read, and equations 1 to 6 are written again in NumPy.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.integrate import ode
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import KDTree

SLACK = 2.0  # times the certificate's own tolerances, for the integration here
POSITION, SPEED, RATE, ANGLE = 1e-3, 1e-2, 1e-2, 1.75e-3  # m, m/s, rad/s, rad: of the certificate
RELATIVE = 1e-3  # of a limit
SAMPLES = 40  # an interval
STEP = 0.1  # of an interval, so that cubics between steps are exact to micrometres
ACCURACY = 1e-8

Box = tuple[np.ndarray, np.ndarray]
Node = tuple[np.ndarray, float]
"""Thrusts, (rotors,), N, and dilation, s, at an end of an interval."""


class World(NamedTuple):
    """The truth about a place."""

    free: Sequence[Box] = ()
    """Boxes whose union the vehicle's centre must not leave; none: anywhere."""
    margin: float = 0.0
    """m, that the centre keeps from the faces of that union."""
    cells: Sequence[tuple[np.ndarray, np.ndarray]] = ()
    """Normals and offsets of polytopes whose union the centre must not leave; none: anywhere."""
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
    start, path = scenario.start, solution.trajectory
    control, dilation = np.asarray(path.control), np.asarray(path.dilation)
    attitude = np.asarray(start.attitude) / np.linalg.norm(start.attitude)
    state = np.concatenate([start.position, start.velocity, attitude, start.body_rate])
    states = []
    for ends in pairwise(zip(control, dilation, strict=True)):
        slope = _slope(scenario.airframe.body, *ends, 1.0 / (len(dilation) - 1))
        solver = ode(slope).set_integrator("dop853", rtol=accuracy, atol=accuracy, max_step=STEP, nsteps=2000)
        steps: list[tuple[float, np.ndarray]] = []
        solver.set_solout(lambda place, x, kept=steps: kept.append((place, x.copy())))
        state = solver.set_initial_value(state, 0.0).integrate(1.0)
        if not solver.successful():
            return np.full((1, 13), np.inf)
        places, values = (np.array(rows) for rows in zip(*steps, strict=True))
        slopes = [slope(place, x) for place, x in steps]
        states.append(CubicHermiteSpline(places, values, slopes)(np.linspace(0.0, 1.0, SAMPLES)))
    return np.concatenate(states)


def _slope(body: Any, first: Node, last: Node, width: float) -> Callable[[float, np.ndarray], tuple]:
    """Derivative by the fraction of an interval; in Python's numbers, which are faster than arrays of three."""
    mass, (gx, gy, gz) = float(body.mass), np.asarray(body.gravity).tolist()
    inertia = np.asarray(body.inertia)
    (ixx, ixy, ixz), (iyx, iyy, iyz), (izx, izy, izz) = inertia.tolist()
    (jxx, jxy, jxz), (jyx, jyy, jyz), (jzx, jzy, jzz) = np.linalg.inv(inertia).tolist()
    wrench = np.concatenate([np.asarray(body.thrust_map), np.asarray(body.torque_map)])
    (u, (d0, d1)) = np.stack([first[0], last[0]]), (width * float(first[1]), width * float(last[1]))
    (fx, fy, fz, mx, my, mz), (gfx, gfy, gfz, gmx, gmy, gmz) = (
        (wrench @ u[0]).tolist(),
        (wrench @ (u[1] - u[0])).tolist(),
    )

    def slope(s: float, x: np.ndarray) -> tuple:
        _, _, _, vx, vy, vz, a, b, c, d, p, q, r = x.tolist()
        h = d0 + s * (d1 - d0)
        x0, y0, z0 = fx + s * gfx, fy + s * gfy, fz + s * gfz
        # force + 2 pure x (pure x force + a force), the rotation of the quaternion (a, pure)
        cx, cy, cz = c * z0 - d * y0 + a * x0, d * x0 - b * z0 + a * y0, b * y0 - c * x0 + a * z0
        ax, ay, az = x0 + 2.0 * (c * cz - d * cy), y0 + 2.0 * (d * cx - b * cz), z0 + 2.0 * (b * cy - c * cx)
        # torque - rate x (inertia rate)
        lx = ixx * p + ixy * q + ixz * r
        ly = iyx * p + iyy * q + iyz * r
        lz = izx * p + izy * q + izz * r
        tx = mx + s * gmx - (q * lz - r * ly)
        ty = my + s * gmy - (r * lx - p * lz)
        tz = mz + s * gmz - (p * ly - q * lx)
        return (
            *(h * vx, h * vy, h * vz),
            *(h * (ax / mass + gx), h * (ay / mass + gy), h * (az / mass + gz)),
            -0.5 * h * (b * p + c * q + d * r),
            0.5 * h * (a * p + c * r - d * q),
            0.5 * h * (a * q + d * p - b * r),
            0.5 * h * (a * r + b * q - c * p),
            *(h * (jxx * tx + jxy * ty + jxz * tz), h * (jyx * tx + jyy * ty + jyz * tz)),
            h * (jzx * tx + jzy * ty + jzz * tz),
        )

    return slope


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
    if len(world.cells):
        depth = np.max([_depth_in_cell(places, *cell) for cell in world.cells], axis=0).min()
        if not depth >= -SLACK * POSITION:
            yield f"leaves the polytopes by {-depth:.3g} m"
    if len(world.solid):
        nearest = min(-_depth(places, low, high).max() for low, high in world.solid)
        if not nearest >= world.least - SLACK * POSITION:
            yield f"comes within {nearest:.3g} m of matter, {world.least:.3g} asked"
    if len(world.points):
        nearest = float(np.min(KDTree(world.points).query(places)[0]))
        if not nearest >= world.least_points - SLACK * POSITION:
            yield f"comes within {nearest:.3g} m of a point, {world.least_points:.3g} asked"


def _depth_in_cell(places: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Distance to the nearest face's plane, negative outside; rows without a normal are no faces."""
    lengths = np.linalg.norm(normals, axis=1)
    faces = lengths > 0.0
    return np.min((offsets - places @ normals.T)[:, faces] / lengths[faces], axis=1)


def _depth(places: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Depth in a box; outside, minus the distance to it."""
    outside = np.linalg.norm(np.maximum(np.maximum(low - places, places - high), 0.0), axis=1)
    inside = np.minimum(places - low, high - places).min(axis=1)
    return np.where(outside > 0.0, -outside, inside)
