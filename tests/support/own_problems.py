"""Optimal control problems with known optima, as functions of one number."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import jaxscp as js


class Case(NamedTuple):
    """A problem, and the cost of its optimum."""

    problem: Callable[[Any], js.OptimalControlProblem]
    """Of the number."""
    value: float
    """Of the number, to begin with."""
    exact: Callable[[float], float]
    """Cost of the optimum."""
    final_time: float | None = None
    """Of the guess; None for a fixed one."""
    error: float = 1e-4
    """Relative."""

    def guess(self, problem: js.OptimalControlProblem) -> js.Trajectory:
        return js.straight_line(problem, self.final_time)


def double_integrator(cost, time, goal=1.0, limit=None, **more):
    """From rest to rest over the distance ``goal``."""
    constraints = () if limit is None else (js.bounds(control=(-limit, limit)),)
    ends = js.Boundary(
        js.fixed_state([0.0, 0.0]), js.fixed_state([goal, 0.0], ("position", "velocity"), ("m", "m/s"))
    )
    return js.OptimalControlProblem(js.DoubleIntegrator(1), cost, ends, time, constraints, **more)


def time_taken(x, t, p):
    return t


def squared_control(x, u, t, p):
    return u @ u


def minimum_time(distance):
    time = js.Time(21, js.FreeTime(0.05, 10.0))
    return double_integrator(js.Cost(terminal=time_taken), time, distance, limit=2.0)


def minimum_energy(duration):
    return double_integrator(js.Cost(running=squared_control), js.Time(11, js.FixedTime(duration)))


def minimum_energy_in_free_time(distance):
    time = js.Time(11, js.FreeTime(0.1, 20.0))
    return double_integrator(js.Cost(running=squared_control), time, distance)


# --- Dubins car around a disc: its path, an arc, a tangent, the disc's arc, a tangent, bounds the optimum ---

EFFORT = 0.01


def car(x, u, t, p):
    return jnp.array([jnp.cos(x[2]), jnp.sin(x[2]), u[0]])


def outside(x, u, t, disc):
    return jnp.linalg.norm(x[:2] - disc["centre"])[None] - disc["radius"]


def dubins(height):
    """Around a disc whose centre has this height."""
    disc = {"centre": jnp.stack([3.0, height]), "radius": 1.0}
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(car, states=3, controls=1),
        cost=js.Cost(running=lambda x, u, t, p: 1.0 + EFFORT * u @ u),
        constraints=(js.bounds(control=(-1.0, 1.0)), js.Constraint(outside, js.NonNegative(), disc)),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([6.0, 0.0, None])),
        time=js.Time(nodes=30, final=js.FreeTime(1.0, 20.0)),
    )


def dubins_cost(height):
    """Below the disc: cost of the Dubins path."""
    x, y, radius, goal = 3.0, -height, 1.0, 6.0
    to_disc, to_goal = np.array([x, y - 1.0]), np.array([goal - x, -y])
    between, after = np.linalg.norm(to_disc), np.linalg.norm(to_goal)
    first = np.arctan2(to_disc[1], to_disc[0]) + np.arcsin((1.0 + radius) / between)
    second = np.arctan2(to_goal[1], to_goal[0]) - np.arcsin(radius / after)
    straight = np.sqrt(between**2 - (1.0 + radius) ** 2) + np.sqrt(after**2 - radius**2)
    length, turn = straight + first + radius * (first - second), first + (first - second)
    return length + EFFORT * turn


# --- brachistochrone ---


def bead(x, u, t, gravity):
    return jnp.stack([x[2] * jnp.sin(u[0]), x[2] * jnp.cos(u[0]), gravity * jnp.cos(u[0])])


def brachistochrone(gravity):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(bead, 3, 1, gravity),
        cost=js.Cost(terminal=time_taken),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([2.0, 2.0, None])),
        time=js.Time(30, js.FreeTime(0.1, 5.0)),
        constraints=(js.bounds(control=(0.0, np.pi)),),
    )


def cycloid_time(gravity):
    """From the origin to (2, 2): theta sqrt(r / g), with r (theta - sin theta) = r (1 - cos theta) = 2."""
    angle = brentq(lambda a: a - np.sin(a) - 1.0 + np.cos(a), 1.0, 6.0)
    return angle * np.sqrt(2.0 / (1.0 - np.cos(angle)) / gravity)


# --- tracking of a sine by a single integrator: r x'' = x - sin t, x(0) = 0, x'(T) = 0 ---

DURATION = 3.0


def single_integrator(x, u, t, p):
    return u


def off_sine(x, u, t, weight):
    return (x[0] - jnp.sin(t)) ** 2 + weight * u @ u


def sine(weight):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(single_integrator, 1, 1),
        cost=js.Cost(running=off_sine, parameters=weight),
        boundary=js.Boundary(js.fixed_state([0.0]), js.fixed_state([None])),
        time=js.Time(30, js.FixedTime(DURATION)),
    )


def sine_cost(weight):
    rate = 1.0 / np.sqrt(weight)
    amplitude = 1.0 / (1.0 + weight)  # x = amplitude sin t + c sinh(rate t)
    c = -amplitude * np.cos(DURATION) / (rate * np.cosh(rate * DURATION))
    t = np.linspace(0.0, DURATION, 200001)
    x = amplitude * np.sin(t) + c * np.sinh(rate * t)
    u = amplitude * np.cos(t) + c * rate * np.cosh(rate * t)
    return np.trapezoid((x - np.sin(t)) ** 2 + weight * u**2, t)


# --- linear-quadratic, against its Riccati equation ---

A, B = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.0]])
Q, R, FINAL = np.diag([3.0, 1.0]), 0.5, np.diag([1.0, 2.0])
START = np.array([1.0, -0.5])


def linear(x, u, t, p):
    return jnp.asarray(A) @ x + jnp.asarray(B) @ u


def quadratic(x, u, t, p):
    return x @ jnp.asarray(Q) @ x + p["effort"] * u @ u


def linear_quadratic(effort):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(linear, 2, 1),
        cost=js.Cost(quadratic, lambda x, t, p: x @ jnp.asarray(FINAL) @ x, {"effort": effort}),
        boundary=js.Boundary(js.fixed_state(START), js.fixed_state([None, None])),
        time=js.Time(30, js.FixedTime(2.0)),
    )


def riccati_cost(effort):
    def rate(_, flat):
        p = flat.reshape(2, 2)
        return (A.T @ p + p @ A - p @ B @ B.T @ p / effort + Q).ravel()

    p = solve_ivp(rate, (0.0, 2.0), FINAL.ravel(), rtol=1e-11, atol=1e-12).y[:, -1].reshape(2, 2)
    return START @ p @ START


# --- metres and newtons of 1e6, with a scale ---

FORCE, FAR = 1e6, 1e6


def pushed(x, u, t, mass):
    return jnp.stack([x[1], u[0] / mass])


def large(mass):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(pushed, 2, 1, mass),
        cost=js.Cost(terminal=time_taken),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([FAR, 0.0])),
        time=js.Time(21, js.FreeTime(1.0, 500.0)),
        constraints=(js.bounds(control=(-FORCE, FORCE)),),
        scale=js.Scale(state=[FAR, 3e4], control=[FORCE], time=60.0),
    )


# --- a moving disc, seen from which the problem is one of a fixed disc ---

DISC_START, DISC_VELOCITY = np.array([2.0, 0.1]), np.array([0.1, 0.2])
TARGET, CROSSING = np.array([4.0, 0.0]), 2.0


def outside_moving(x, u, t, radius):
    return jnp.linalg.norm(x - (DISC_START + DISC_VELOCITY * t))[None] - radius


def moving_obstacle(radius):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(single_integrator, 2, 2),
        cost=js.Cost(running=squared_control),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state(TARGET)),
        time=js.Time(41, js.FixedTime(CROSSING)),
        constraints=(js.Constraint(outside_moving, js.NonNegative(), radius),),
    )


def moving_obstacle_cost(radius):
    """In the frame of the disc the shortest path, at constant speed; the frame's own motion adds the rest."""
    a = -DISC_START
    b = TARGET - DISC_VELOCITY * CROSSING - DISC_START
    between = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    tangents = [np.sqrt(v @ v - radius**2) for v in (a, b)]
    arc = between - sum(np.arccos(radius / np.linalg.norm(v)) for v in (a, b))
    length = sum(tangents) + radius * arc
    return length**2 / CROSSING + 2.0 * DISC_VELOCITY @ (b - a) + DISC_VELOCITY @ DISC_VELOCITY * CROSSING


# --- a periodic path: x = cos(w t) / (1 + r w^2) ---


def off_cosine(x, u, t, p):
    return (x[0] - jnp.cos(2.0 * t)) ** 2 + p["weight"] * u @ u


def loop(weight):
    free = js.fixed_state([None])
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(single_integrator, 1, 1),
        cost=js.Cost(running=off_cosine, parameters={"weight": weight}),
        boundary=js.Boundary(free, free, js.periodic()),
        time=js.Time(41, js.FixedTime(np.pi)),
    )


CASES = {
    "minimum time": Case(minimum_time, 1.0, lambda d: 2.0 * np.sqrt(d / 2.0), 2.0),
    "minimum energy": Case(minimum_energy, 2.0, lambda t: 12.0 / t**3),
    "minimum energy, free time": Case(
        minimum_energy_in_free_time, 100.0, lambda d: 12.0 * d**2 / 20.0**3, 10.0
    ),
    # first-order hold cannot turn in jumps, and a margin is kept between the nodes
    "Dubins": Case(dubins, 0.2, dubins_cost, 6.0, error=1e-3),
    "brachistochrone": Case(brachistochrone, 9.81, cycloid_time, 1.5),
    "sine": Case(sine, 0.3, sine_cost),
    "linear-quadratic": Case(linear_quadratic, R, riccati_cost),
    "1e6": Case(large, 1e3, lambda m: 2.0 * np.sqrt(FAR * m / FORCE), 100.0),
    "moving obstacle": Case(moving_obstacle, 0.6, moving_obstacle_cost, error=1e-3),
    "periodic": Case(loop, 0.25, lambda r: 0.5 * np.pi * 4.0 * r / (1.0 + 4.0 * r)),
}
