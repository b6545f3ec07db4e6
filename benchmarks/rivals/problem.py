"""One landing problem as plain arrays, the three-box example, and a simulation to check solutions.

Everything here is NumPy in float64. State x (13) = [p, v, q, omega]: position and velocity in the world, unit
quaternion (w, x, y, z) from body to world, body rate. Control u (m): rotor thrusts. Dilation s = dt/dtau.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

STATES = 13
POSITION, VELOCITY, ATTITUDE, RATE = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)


@dataclass(frozen=True, eq=False)
class LandingArrays:
    """Minimise w_u * integral |u| dt + w_t * t_f on N nodes uniform in tau; first-order hold on u and s."""

    mass: float
    """Kilograms."""
    inertia: Floats
    """(3, 3), kilogram square metres."""
    thrust_map: Floats
    """(3, m): force on the body in its own axes, per newton of rotor thrust."""
    torque_map: Floats
    """(3, m): torque on the body in its own axes, newton metres per newton of rotor thrust."""
    gravity: float
    """Along -z, metres per square second."""
    normals: Floats
    """(N, F, 3) half-spaces normals @ p <= offsets of each node; unused rows are 0 . p <= 1."""
    offsets: Floats
    """(N, F)."""
    cone_active: Flags
    """(N,): the nodes that lie in the landing cone."""
    cone_apex: Floats
    """(3,), the landing point."""
    cone_cotangent: float
    """The bound is |horizontal offset from the apex| <= cotangent * height above it."""
    thrust_min: Floats
    """(m,), newtons."""
    thrust_max: Floats
    """(m,), newtons."""
    dilation_min: float
    """Seconds."""
    dilation_max: float
    """Seconds."""
    start: Floats
    """(13,)."""
    goal: Floats
    """(13,)."""
    weight_control: float
    weight_time: float
    weight_virtual: float
    weight_trust: float
    tolerance_virtual: float
    tolerance_trust: float
    max_iterations: int
    substeps: int
    """Runge-Kutta steps in each interval."""
    states: Floats
    """(N, 13), the initial guess."""
    controls: Floats
    """(N, m), the initial guess."""
    dilation: Floats
    """(N,), the initial guess."""

    @property
    def nodes(self) -> int:
        """Number of nodes, N."""
        return len(self.dilation)

    @property
    def rotors(self) -> int:
        """Number of rotors, m."""
        return self.thrust_map.shape[1]

    @property
    def interval(self) -> float:
        """Length of one interval in tau."""
        return 1.0 / (self.nodes - 1)


def extended_controls(problem: LandingArrays) -> Floats:
    """Thrusts and dilation of the guess side by side, (N, m + 1), as the transcriptions use them."""
    return np.column_stack([problem.controls, problem.dilation])


# the three-box problem


def three_box() -> LandingArrays:
    """A level start at rest, two right-angled corners, and a landing under a 45 degree cone, on 30 nodes."""
    nodes, guessed_time = 30, 6.0
    corners = np.array([[0, 0, 1], [3.5, 0.2, 1.5], [3.5, 4.5, 1.5], [8, 4.5, 2], [8, 4.5, 0.5]], dtype=float)
    positions = along_polyline(corners, nodes)
    normals, offsets = roomiest_box(
        positions,
        lower=np.array([[-1, -1, -0.2], [2.8, -1, -0.2], [2.8, 3.8, -0.2]]),
        upper=np.array([[4.2, 1.2, 3.0], [4.2, 5.2, 3.0], [9.0, 5.2, 3.0]]),
    )
    mass, gravity = 0.928, 9.81
    thrust_map, torque_map = quadrotor_maps(arm=0.076, torque_ratio=0.016)
    states = np.array([at_rest(position) for position in positions])
    states[1:-1, VELOCITY] = np.gradient(positions, guessed_time / (nodes - 1), axis=0)[1:-1]
    return LandingArrays(
        mass=mass,
        inertia=np.diag([2.5e-3, 2.1e-3, 4.3e-3]),
        thrust_map=thrust_map,
        torque_map=torque_map,
        gravity=gravity,
        normals=normals,
        offsets=offsets,
        cone_active=np.arange(nodes) >= nodes - 6,
        cone_apex=corners[-1],
        cone_cotangent=1.0,
        thrust_min=np.full(4, 0.3),
        thrust_max=np.full(4, 5.0),
        dilation_min=0.5,
        dilation_max=20.0,
        start=states[0],
        goal=states[-1],
        weight_control=1.0,
        weight_time=0.0,
        weight_virtual=1000.0,
        weight_trust=10.0,
        tolerance_virtual=1e-3,
        tolerance_trust=1e-2,
        max_iterations=50,
        substeps=10,
        states=states,
        controls=np.full((nodes, 4), mass * gravity / 4),
        dilation=np.full(nodes, guessed_time),
    )


def quadrotor_maps(arm: float, torque_ratio: float) -> tuple[Floats, Floats]:
    """Thrust and torque maps of four upright rotors at 45 + 90 i degrees, spinning + - + -."""
    angles = np.deg2rad([45.0, 135.0, 225.0, 315.0])
    thrust_map = np.zeros((3, 4))
    thrust_map[2] = 1.0
    spin = np.array([1.0, -1.0, 1.0, -1.0])
    torque_map = np.array([arm * np.sin(angles), -arm * np.cos(angles), torque_ratio * spin])
    return thrust_map, torque_map


def at_rest(position: Floats) -> Floats:
    """The state (13,) that hovers level at a position."""
    return np.concatenate([position, np.zeros(3), [1.0, 0.0, 0.0, 0.0], np.zeros(3)])


def along_polyline(corners: Floats, count: int) -> Floats:
    """Points (count, 3) at equal arc length along straight lines between corners."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    at_corner = np.concatenate([[0.0], np.cumsum(lengths)])
    at_point = np.linspace(0.0, at_corner[-1], count)
    return np.column_stack([np.interp(at_point, at_corner, corners[:, axis]) for axis in range(3)])


def roomiest_box(positions: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Half-spaces (N, 6, 3) and (N, 6) of the box with most clearance at each position.

    Of equal boxes the later one is taken. Clearance is compared to the nanometre, so that rounding does not decide:
    node 8 of the three boxes has the same clearance in the first and in the second.
    """
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    offsets = np.concatenate([upper, -lower], axis=1)
    clearance = np.min(offsets - (positions @ faces.T)[:, None, :], axis=2)
    chosen = len(offsets) - 1 - np.argmax(np.round(clearance[:, ::-1], 9), axis=1)
    return np.tile(faces, (len(positions), 1, 1)), offsets[chosen]


# a plain simulation, to check solutions


def state_rate(problem: LandingArrays, state: Floats, thrusts: Floats) -> Floats:
    """Time derivative (13,) of the rigid body's state."""
    velocity, (w, *vector), rate = state[VELOCITY], state[ATTITUDE], state[RATE]
    force = problem.thrust_map @ thrusts / problem.mass
    turned = force + 2.0 * w * np.cross(vector, force) + 2.0 * np.cross(vector, np.cross(vector, force))
    acceleration = turned - np.array([0.0, 0.0, problem.gravity])
    attitude_rate = 0.5 * np.concatenate([[-np.dot(vector, rate)], w * rate + np.cross(vector, rate)])
    torque = problem.torque_map @ thrusts - np.cross(rate, problem.inertia @ rate)
    rate_of_rate = np.linalg.solve(problem.inertia, torque)
    return np.concatenate([velocity, acceleration, attitude_rate, rate_of_rate], dtype=np.float64)


def fly_interval(
    problem: LandingArrays, state: Floats, now: Floats, following: Floats, substeps: int
) -> Floats:
    """States (substeps + 1, 13) across one interval from its first node.

    Args:
        problem: the vehicle.
        state: (13,) at the first node.
        now: (m + 1,) thrusts and dilation at the first node.
        following: (m + 1,) thrusts and dilation at the second.
        substeps: Runge-Kutta steps.
    """

    def rate(fraction: float, x: Floats) -> Floats:
        held = (1.0 - fraction) * now + fraction * following
        return problem.interval * held[-1] * state_rate(problem, x, held[:-1])

    path, h = [state], 1.0 / substeps
    for step in range(substeps):
        x, fraction = path[-1], step * h
        k1 = rate(fraction, x)
        k2 = rate(fraction + h / 2, x + h / 2 * k1)
        k3 = rate(fraction + h / 2, x + h / 2 * k2)
        k4 = rate(fraction + h, x + h * k3)
        path.append(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(path)


def fly(
    problem: LandingArrays, states: Floats, controls: Floats, dilation: Floats, substeps: int = 20
) -> Floats:
    """States (N - 1, substeps + 1, 13) across every interval, each integrated from its own first node."""
    extended = np.column_stack([controls, dilation])
    return np.array(
        [
            fly_interval(problem, states[i], extended[i], extended[i + 1], substeps)
            for i in range(problem.nodes - 1)
        ]
    )


def worst_defect(problem: LandingArrays, states: Floats, flown: Floats) -> float:
    """Largest defect: |integrated state - given state| at a node."""
    return float(np.abs(flown[:, -1] - states[1:]).max())


def worst_escape(problem: LandingArrays, positions: Floats) -> float:
    """Largest distance in metres by which positions (..., 3) lie outside every polytope of the corridor."""
    points = positions.reshape(-1, 3)
    beyond = np.einsum("kfa,pa->kpf", problem.normals, points) - problem.offsets[:, None, :]
    return float(max(0.0, beyond.max(axis=2).min(axis=0).max()))


def worst_cone_gap(problem: LandingArrays, positions: Floats) -> float:
    """Largest |horizontal offset| - cotangent * height in metres of positions (..., 3), zero at least."""
    from_apex = positions.reshape(-1, 3) - problem.cone_apex
    gap = np.linalg.norm(from_apex[:, :2], axis=1) - problem.cone_cotangent * from_apex[:, 2]
    return float(max(0.0, gap.max(initial=0.0)))
