"""A vehicle crosses the way of another one, which keeps its course: it lets the other pass, and drives behind it.

The velocity is the control. In ten seconds the vehicle covers 40 m with the least integral of the squared velocity, and
keeps 6 m away from the other one.

Reference: in the frame of the other vehicle, the shortest path around a fixed disc, driven at constant speed.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from matplotlib.patches import Circle

import jaxscp as js
from examples.drawing import OBSTACLE, History, page
from examples.support import exact, show

GOAL, DURATION = [40.0, 0.0], 10.0  # m, s
START, VELOCITY = np.array([20.0, -13.0]), np.array([0.0, 3.0])  # of the other vehicle, m and m/s


def drive(x, u, t, p):
    return u


def apart(x, u, t, distance):
    return jnp.linalg.norm(x - START - VELOCITY * t)[None] - distance


def problem(distance=6.0):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(drive, states=2, controls=2),
        cost=js.Cost(running=lambda x, u, t, p: u @ u),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state(GOAL)),
        time=js.Time(nodes=81, final=js.FixedTime(DURATION)),
        constraints=(js.Constraint(apart, js.NonNegative(), distance),),
    )


def guess(problem):
    return js.straight_line(problem)


# --- what to expect ---


def closed_form(distance):
    """Squared length in the frame of the other vehicle by duration, and what that frame's motion adds."""
    a = -START
    b = np.array(GOAL) - VELOCITY * DURATION - START
    between = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    arc = between - sum(np.arccos(distance / np.linalg.norm(v)) for v in (a, b))
    length = sum(np.sqrt(v @ v - distance**2) for v in (a, b)) + distance * arc
    return length**2 / DURATION + 2.0 * VELOCITY @ (b - a) + VELOCITY @ VELOCITY * DURATION


REFERENCE = exact(closed_form(6.0), "shortest path around a disc")


def draw(solution):
    """Both ways, and the other vehicle's disc at four times."""
    speed = History("velocity in m/s", lambda x, u: u)
    figure, path = page(problem(), solution, ("x in m", "y in m"), [speed])
    for t in (2.5, 5.0, 7.5):
        path.add_patch(Circle(START + VELOCITY * t, 6.0, **OBSTACLE))
    path.axis("equal")
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("crossing", solution, REFERENCE, draw(solution))
