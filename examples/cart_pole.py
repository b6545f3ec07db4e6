"""A cart swings its pole up in two seconds, with the least integral of the squared force.

Numbers: Kelly, "An introduction to trajectory optimization: how to do your own direct collocation", SIAM Review 59
(2017), section 6. From the straight line, the guess of that paper, solvers end at another local optimum, 58.81.

Reference: IPOPT on the same transcription, the best of four starts.
"""

import dataclasses

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np

import jaxscp as js
from examples.drawing import History, page
from examples.support import ipopt, show

CART, LENGTH, GRAVITY = 1.0, 0.5, 9.81  # kg, m, m/s^2
DISTANCE, DURATION = 1.0, 2.0  # m, s
REACH, FORCE = 2.0, 20.0  # limits in m and N


def cart_pole(x, u, t, pole):  # x = (position, angle from hanging, both rates), u = (force,)
    sine, cosine, swing = jnp.sin(x[1]), jnp.cos(x[1]), LENGTH * pole * jnp.sin(x[1]) * x[3] ** 2
    moved = CART + pole * sine**2
    push = (swing + u[0] + pole * GRAVITY * cosine * sine) / moved
    turn = -(swing * cosine + u[0] * cosine + (CART + pole) * GRAVITY * sine) / (LENGTH * moved)
    return jnp.stack([x[2], x[3], push, turn])


def problem(pole=0.3):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(cart_pole, states=4, controls=1, parameters=pole),
        cost=js.Cost(running=lambda x, u, t, p: u @ u),
        boundary=js.Boundary(
            js.fixed_state([0.0, 0.0, 0.0, 0.0]), js.fixed_state([DISTANCE, np.pi, 0.0, 0.0])
        ),
        time=js.Time(nodes=40, final=js.FixedTime(DURATION)),
        constraints=(
            js.bounds(state=([-REACH, None, None, None], [REACH, None, None, None]), control=(-FORCE, FORCE)),
        ),
    )


def guess(problem):  # the pole swings back before it goes up
    line = js.straight_line(problem)
    return dataclasses.replace(line, state=line.state.at[:, 1].add(2.0 * jnp.sin(jnp.pi * line.time)))


# --- what to expect ---

REFERENCE = ipopt(57.947956)


def draw(solution):
    """The pole, now and then, with the path of its end."""
    force = History("force in N", lambda x, u: u[:, 0], limits=(-FORCE, FORCE))
    angle = History("angle in rad", lambda x, u: x[:, 1])
    end = lambda x: np.stack([x[:, 0] + LENGTH * np.sin(x[:, 1]), -LENGTH * np.cos(x[:, 1])], axis=1)
    figure, path = page(problem(), solution, ("x in m", "z in m"), [force, angle], place=end)
    poles = np.asarray(solution.trajectory.state)[::3]
    for cart, tip in zip(poles[:, 0], end(poles), strict=True):
        path.plot([cart, tip[0]], [0.0, tip[1]], color="0.7", linewidth=0.8, zorder=0)
    path.axis("equal")
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("cart_pole", solution, REFERENCE, draw(solution))
