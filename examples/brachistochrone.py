"""The brachistochrone: the fastest slide of a bead without friction, from rest, to a point 2 m away and 2 m below.

Reference: the cycloid through both points (Johann Bernoulli, 1696), 0.8243 s.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import jaxscp as js
from examples.drawing import History, page
from examples.support import exact, show


def bead(x, u, t, gravity):  # x = (along, down, speed), u = (angle from the vertical,)
    return jnp.stack([x[2] * jnp.sin(u[0]), x[2] * jnp.cos(u[0]), gravity * jnp.cos(u[0])])


def problem(gravity=9.81):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(bead, states=3, controls=1, parameters=gravity),
        cost=js.Cost(terminal=lambda x, t, p: t),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([2.0, 2.0, None])),
        time=js.Time(nodes=30, final=js.FreeTime(0.1, 5.0)),
        constraints=(js.bounds(control=(0.0, np.pi)),),
    )


def guess(problem):
    return js.straight_line(problem, final_time=1.5)


# --- what to expect ---


def closed_form(gravity):
    """Time: a sqrt(r / g), with r (a - sin a) = r (1 - cos a) = 2 m at the end."""
    angle = brentq(lambda a: a - np.sin(a) - 1.0 + np.cos(a), 1.0, 6.0)
    return angle * np.sqrt(2.0 / (1.0 - np.cos(angle)) / gravity)


REFERENCE = exact(closed_form(9.81), "cycloid")


def draw(solution):
    """The slide, from the top left, beside the cycloid."""
    angle = History("angle in rad", lambda x, u: u[:, 0], limits=(0.0, np.pi))
    speed = History("speed in m/s", lambda x, u: x[:, 2])
    figure, path = page(problem(), solution, ("along in m", "down in m"), [angle, speed])
    path.invert_yaxis()
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("brachistochrone", solution, REFERENCE, draw(solution))
