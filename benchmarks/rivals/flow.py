"""The published stack's discretisation, equations (12)-(18), compiled by Numba: rigid body, RK4, inverse-free form."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from benchmarks.rivals.problem import STATES, Floats, LandingArrays


@dataclass(frozen=True, eq=False)
class Discretisation:
    """x[i+1] = A x[i] + B- v[i] + B+ v[i+1] + c, and the effort of each interval; v = (u, s)."""

    state: Floats
    """A, (N - 1, 13, 13)."""
    control_now: Floats
    """B-, (N - 1, 13, m + 1)."""
    control_next: Floats
    """B+, (N - 1, 13, m + 1)."""
    offset: Floats
    """c = F - A x - B- v[i] - B+ v[i+1], (N - 1, 13)."""
    flown: Floats
    """F, (N - 1, 13): the reference integrated from each node to the next."""
    effort: Floats
    """Integral of |u| dt over each interval of the reference, (N - 1,)."""
    effort_now: Floats
    """Derivative of the effort in v[i], (N - 1, m + 1)."""
    effort_next: Floats
    """Derivative of the effort in v[i+1], (N - 1, m + 1)."""


def discretise(problem: LandingArrays, states: Floats, extended: Floats) -> Discretisation:
    """Linearise the flow of every interval about states (N, 13) and extended controls (N, m + 1)."""
    extended = _plain(extended)
    flown, sensitivity = _flow(
        _plain(states),
        extended,
        problem.substeps,
        _plain(problem.thrust_map / problem.mass),
        _plain(problem.torque_map),
        _plain(problem.inertia),
        _plain(np.linalg.inv(problem.inertia)),
        float(problem.gravity),
    )
    width = extended.shape[1]
    state = sensitivity[:, :, :STATES]
    now = sensitivity[:, :, STATES : STATES + width]
    following = sensitivity[:, :, STATES + width :]
    linear = (
        np.einsum("kij,kj->ki", state, states[:-1])
        + np.einsum("kij,kj->ki", now, extended[:-1])
        + np.einsum("kij,kj->ki", following, extended[1:])
    )
    return Discretisation(state, now, following, flown - linear, flown, *_effort(extended, problem.substeps))


def _plain(array: np.ndarray) -> Floats:
    """A writable copy in C order: Numba would compile again for every other layout."""
    return np.array(array, dtype=np.float64, order="C")


@njit(cache=True)
def _flow(states, extended, substeps, acceleration_map, torque_map, inertia, inverse_inertia, gravity):
    """End states (N - 1, 13) of the intervals and their sensitivities (N - 1, 13, 13 + 2 (m + 1)).

    The sensitivity S to (x[i], v[i], v[i+1]) has the equation:
    S' = f_x S + [0, (1 - lambda) f_v, lambda f_v], S(0) = [I, 0, 0].
    No inverse of the transition matrix is needed.
    """
    intervals, width = len(states) - 1, extended.shape[1]
    flown, sensitivity = states[1:].copy(), np.zeros((intervals, 13, 13 + 2 * width))
    h = 1.0 / substeps
    shares = np.array([0.0, h / 2.0, h / 2.0, h])
    weights = np.array([h / 6.0, h / 3.0, h / 3.0, h / 6.0])
    slope, big_slope = np.zeros(13), np.zeros((13, 13 + 2 * width))
    for i in range(intervals):
        x, big = flown[i], sensitivity[i]
        x[:] = states[i]
        for row in range(13):
            big[row, row] = 1.0
        for step in range(substeps):
            x_start, big_start = x.copy(), big.copy()
            for stage in range(4):
                fraction = step * h + shares[stage]
                held = (1.0 - fraction) * extended[i] + fraction * extended[i + 1]
                trial, big_trial = x_start + shares[stage] * slope, big_start + shares[stage] * big_slope
                rate, in_state, in_thrust = _rate_and_jacobians(
                    trial, held[:-1], acceleration_map, torque_map, inertia, inverse_inertia, gravity
                )
                scale = held[-1] / intervals
                _variational_rate(rate, in_state, in_thrust, big_trial, scale, fraction, intervals, big_slope)
                slope = scale * rate
                x += weights[stage] * slope
                big += weights[stage] * big_slope
    return flown, sensitivity


@njit(cache=True)
def _variational_rate(rate, in_state, in_thrust, big, scale, fraction, intervals, big_rate):
    """Write the sensitivity's rate, per unit of lambda in [0, 1] across one interval, into big_rate."""
    rotors, columns = in_thrust.shape[1], big.shape[1]
    big_rate[:] = 0.0
    for row in range(13):
        for inner in range(13):
            entry = scale * in_state[row, inner]
            if entry != 0.0:  # two thirds of f_x are zeros
                for column in range(columns):
                    big_rate[row, column] += entry * big[inner, column]
        for control in range(rotors + 1):
            entry = scale * in_thrust[row, control] if control < rotors else rate[row] / intervals
            big_rate[row, 13 + control] += (1.0 - fraction) * entry
            big_rate[row, 14 + rotors + control] += fraction * entry


@njit(cache=True)
def _rate_and_jacobians(x, thrusts, acceleration_map, torque_map, inertia, inverse_inertia, gravity):
    """Equations (1)-(6): dx/dt (13,), its Jacobian in x (13, 13) and in the thrusts (13, m)."""
    w, r, omega = x[6], x[7:10], x[10:13]
    rate, in_state = np.zeros(13), np.zeros((13, 13))
    in_thrust = np.zeros((13, len(thrusts)))

    rate[0:3] = x[3:6]
    for axis in range(3):
        in_state[axis, 3 + axis] = 1.0

    # R(q) a = a + 2 w r x a + 2 r x (r x a)
    a = acceleration_map @ thrusts
    cross_r, cross_a = _cross_matrix(r), _cross_matrix(a)
    rotation = np.eye(3) + 2.0 * w * cross_r + 2.0 * cross_r @ cross_r
    rate[3:6] = rotation @ a
    rate[5] -= gravity
    in_state[3:6, 6] = 2.0 * cross_r @ a
    in_state[3:6, 7:10] = (
        2.0 * np.outer(r, a) - 4.0 * np.outer(a, r) + 2.0 * np.dot(r, a) * np.eye(3) - 2.0 * w * cross_a
    )
    in_thrust[3:6] = rotation @ acceleration_map

    # q' = q (0, omega) / 2
    cross_omega = _cross_matrix(omega)
    rate[6] = -0.5 * np.dot(r, omega)
    rate[7:10] = 0.5 * (w * omega + cross_r @ omega)
    in_state[6, 7:10] = -0.5 * omega
    in_state[6, 10:13] = -0.5 * r
    in_state[7:10, 6] = 0.5 * omega
    in_state[7:10, 7:10] = -0.5 * cross_omega
    in_state[7:10, 10:13] = 0.5 * (w * np.eye(3) + cross_r)

    # J omega' = torque - omega x J omega
    momentum = inertia @ omega
    rate[10:13] = inverse_inertia @ (torque_map @ thrusts - cross_omega @ momentum)
    in_state[10:13, 10:13] = inverse_inertia @ (_cross_matrix(momentum) - cross_omega @ inertia)
    in_thrust[10:13] = inverse_inertia @ torque_map
    return rate, in_state, in_thrust


@njit(cache=True)
def _cross_matrix(a):
    """The matrix (3, 3) with _cross_matrix(a) @ b = a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@njit(cache=True)
def _effort(extended, substeps):
    """Effort of each interval and its two gradients; Runge-Kutta of a pure integral is Simpson's rule."""
    intervals, width = len(extended) - 1, extended.shape[1]
    effort = np.zeros(intervals)
    now, following = np.zeros((intervals, width)), np.zeros((intervals, width))
    points = 2 * substeps
    entry = np.empty(width)
    for i in range(intervals):
        for j in range(points + 1):
            simpson = 1.0 if j in (0, points) else (4.0 if j % 2 == 1 else 2.0)
            weight = simpson / (3.0 * points * intervals)
            fraction = j / points
            held = (1.0 - fraction) * extended[i] + fraction * extended[i + 1]
            size = max(np.sqrt(np.sum(held[:-1] ** 2)), 1e-12)  # |u| has no gradient at rest
            effort[i] += weight * size * held[-1]
            entry[:-1] = weight * held[-1] * held[:-1] / size
            entry[-1] = weight * size
            now[i] += (1.0 - fraction) * entry
            following[i] += fraction * entry
    return effort, now, following


def elapsed_along(problem: LandingArrays, extended: Floats) -> Floats:
    """Effort phi and time t at every node, (N, 2), from zero; the trapezoid rule is exact for t."""
    effort, _, _ = _effort(_plain(extended), problem.substeps)
    duration = problem.interval * (extended[:-1, -1] + extended[1:, -1]) / 2.0
    return np.concatenate([np.zeros((1, 2)), np.cumsum(np.column_stack([effort, duration]), axis=0)])
