"""A chaser meets its target on a circular orbit after half an hour, with the least integral of squared acceleration.

Relative motion: Clohessy and Wiltshire (1960). Axes: radial, along the orbit, across it.

Reference: linear-quadratic, from the controllability Gramian of these equations.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import jaxscp as js
from examples.drawing import History, page
from examples.support import exact, show

START = [-200.0, -1000.0, 100.0, 0.0, 0.3, 0.0]  # m, m/s
DURATION = 1800.0  # s


def relative_motion(x, u, t, rate):
    fall = jnp.stack([3.0 * rate**2 * x[0] + 2.0 * rate * x[4], -2.0 * rate * x[3], -(rate**2) * x[2]])
    return jnp.concatenate([x[3:], fall + u])


def problem(rate=1.13e-3):  # rad/s: of an orbit 400 km above the Earth
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(relative_motion, states=6, controls=3, parameters=rate),
        cost=js.Cost(running=lambda x, u, t, p: u @ u),
        boundary=js.Boundary(js.fixed_state(START), js.fixed_state(np.zeros(6))),
        time=js.Time(nodes=31, final=js.FixedTime(DURATION)),
        scale=js.Scale(state=[1e3, 1e3, 1e3, 1.0, 1.0, 1.0], control=[1e-3] * 3, time=DURATION),
    )


def guess(problem):
    return js.straight_line(problem)


# --- what to expect ---


def closed_form(rate):
    """d' W^-1 d: W is the Gramian. d is the end less the free motion from the start."""
    zero, one = np.zeros((3, 3)), np.eye(3)
    spin = np.array([[0.0, 2.0 * rate, 0.0], [-2.0 * rate, 0.0, 0.0], [0.0, 0.0, 0.0]])
    a, b = np.block([[zero, one], [np.diag([3.0 * rate**2, 0.0, -(rate**2)]), spin]]), np.vstack([zero, one])

    def growth(t, w):
        w = w.reshape(6, 6)
        return (a @ w + w @ a.T + b @ b.T).ravel()

    gramian = solve_ivp(growth, (0.0, DURATION), np.zeros(36), rtol=1e-10, atol=1e-8).y[:, -1].reshape(6, 6)
    lack = expm(a * DURATION) @ np.array(START)
    return lack @ np.linalg.solve(gramian, lack)


REFERENCE = exact(closed_form(1.13e-3), "controllability Gramian")


def draw(solution):
    """The approach in the plane of the orbit."""
    acceleration = History("acceleration in mm/s²", lambda x, u: 1e3 * u)
    distance = History("distance in m", lambda x, u: np.linalg.norm(x[:, :3], axis=1))
    across = lambda x: x[:, [1, 0]]
    labels = ("along the orbit in m", "radial in m")
    figure, path = page(problem(), solution, labels, [acceleration, distance], place=across)
    path.axis("equal")
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("rendezvous", solution, REFERENCE, draw(solution))
