"""A car of constant speed and bounded turn rate drives around a disc to a point behind it, in the shortest time.

Reference: the Dubins path (Dubins, 1957): an arc, a tangent, an arc of the disc, a tangent. It bounds the optimum from
above; a small weight of the turn rate makes the optimum unique.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np
from matplotlib.patches import Circle

import jaxscp as js
from examples.drawing import OBSTACLE, History, page
from examples.support import exact, show

EFFORT = 1e-3


def car(x, u, t, p):  # x = (px, py, heading), u = (turn rate,)
    return jnp.stack([jnp.cos(x[2]), jnp.sin(x[2]), u[0]])


def outside(x, u, t, disc):
    return jnp.linalg.norm(x[:2] - disc["centre"])[None] - disc["radius"]


def problem(height=0.5):
    disc = {"centre": jnp.stack([3.0, height]), "radius": 1.0}
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(car, states=3, controls=1),
        cost=js.Cost(running=lambda x, u, t, p: 1.0 + EFFORT * u @ u),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([6.0, 0.0, None])),
        time=js.Time(nodes=61, final=js.FreeTime(1.0, 20.0)),
        constraints=(js.bounds(control=(-1.0, 1.0)), js.Constraint(outside, js.NonNegative(), disc)),
    )


def guess(problem):
    return js.straight_line(problem, final_time=6.0)


# --- what to expect ---


def closed_form(height):
    """Cost of the Dubins path below the disc."""
    x, y, radius, goal = 3.0, -height, 1.0, 6.0
    to_disc, to_goal = np.array([x, y - 1.0]), np.array([goal - x, -y])
    between, after = np.linalg.norm(to_disc), np.linalg.norm(to_goal)
    first = np.arctan2(to_disc[1], to_disc[0]) + np.arcsin((1.0 + radius) / between)
    second = np.arctan2(to_goal[1], to_goal[0]) - np.arcsin(radius / after)
    straight = np.sqrt(between**2 - (1.0 + radius) ** 2) + np.sqrt(after**2 - radius**2)
    length, turn = straight + first + radius * (first - second), first + (first - second)
    return length + EFFORT * turn


REFERENCE = exact(closed_form(0.5), "Dubins path")


def draw(solution):
    """The path around the disc."""
    turn = History("turn rate in rad/s", lambda x, u: u[:, 0], limits=(-1.0, 1.0))
    heading = History("heading in rad", lambda x, u: x[:, 2])
    figure, path = page(problem(), solution, ("x in m", "y in m"), [turn, heading])
    path.add_patch(Circle((3.0, 0.5), 1.0, **OBSTACLE))
    path.axis("equal")
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("dubins", solution, REFERENCE, draw(solution))
