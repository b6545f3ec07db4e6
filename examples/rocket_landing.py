"""A rocket with a gimballed engine lands upright in the shortest time: a rigid body of falling mass.

Numbers, without units as there: M. Szmuk, B. Acikmese, "Successive Convexification for 6-DoF Mars Rocket Powered
Landing with Free-Final-Time", AIAA SciTech Forum 2018, doi 10.2514/6.2018-0617. Its table lacks three numbers: the
mass that a unit of thrust burns in a second (here 0.05), the first velocity (here 2, across), and the first attitude
(here upright).

Reference: IPOPT on the same transcription, the best of four starts.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
import numpy as np

import jaxscp as js
from examples.drawing import History, page
from examples.support import ipopt, show

WET, DRY, BURN, INERTIA = 2.0, 1.0, 0.05, 0.01
LEAST, MOST, ENGINE = 0.3, 5.0, jnp.array([-0.01, 0.0, 0.0])  # thrust, and where it acts
GIMBAL, TILT, SLOPE, RATE = np.deg2rad([20.0, 90.0, 20.0, 60.0])  # limits of angles and of the body rate
START = [WET, 4.0, 4.0, 0.0, 0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
END = [None, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0, None, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def rocket(
    x, u, t, p
):  # x = (mass, position, velocity, quaternion, body rate), the first axis up; u = thrust
    v, w, q, rate = x[4:7], x[7], x[8:11], x[11:]
    twist = jnp.cross(q, u)
    acceleration = (u + 2.0 * (w * twist + jnp.cross(q, twist))) / x[0] - jnp.array([1.0, 0.0, 0.0])
    turn = 0.5 * jnp.append(-q @ rate, w * rate + jnp.cross(q, rate))
    burn = -BURN * jnp.linalg.norm(u)[None]
    return jnp.concatenate([burn, v, acceleration, turn, jnp.cross(ENGINE, u) / INERTIA])


def at_most(bound, vector, **more):  # |vector(x, u)| <= bound(x, u, p)
    value = lambda x, u, t, p: jnp.append(bound(x, u, p), vector(x, u))
    return js.Constraint(value, js.SecondOrder(), convex=True, **more)


def problem(most=MOST):
    nodes = 50
    constraints = (
        js.bounds(state=([DRY, *[None] * 13], None), name="dry mass"),
        js.Constraint(
            lambda x, u, t, p: jnp.linalg.norm(u)[None] - LEAST, js.NonNegative(), name="least thrust"
        ),
        at_most(lambda x, u, p: p, lambda x, u: u, parameters=most, name="most thrust"),
        at_most(lambda x, u, p: u[0] / np.cos(GIMBAL), lambda x, u: u, name="gimbal"),
        at_most(lambda x, u, p: np.sin(TILT / 2.0), lambda x, u: x[9:11], name="tilt"),
        at_most(lambda x, u, p: RATE, lambda x, u: x[11:], name="body rate"),
        at_most(
            lambda x, u, p: x[1] / np.tan(SLOPE),
            lambda x, u: x[2:4],
            active=jnp.arange(nodes) < nodes - 1,
            name="glide slope",
        ),
    )
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(rocket, states=14, controls=3),
        cost=js.Cost(terminal=lambda x, t, p: t),
        boundary=js.Boundary(js.fixed_state(START), js.fixed_state(END)),
        time=js.Time(nodes=nodes, final=js.FreeTime(0.5, 20.0)),
        constraints=constraints,
    )


def guess(problem):
    return js.straight_line(problem, final_time=5.0, control=[WET, 0.0, 0.0])


# --- what to expect ---

REFERENCE = ipopt(float("nan"))


def draw(solution):
    """The descent."""
    thrust = History("thrust", lambda x, u: np.linalg.norm(u, axis=1), limits=(LEAST, MOST))
    tilt = History(
        "tilt in degrees",
        lambda x, u: np.rad2deg(np.arccos(np.clip(1.0 - 2.0 * np.sum(x[:, 9:11] ** 2, axis=1), -1.0, 1.0))),
        limits=(np.rad2deg(TILT),),
    )
    labels = ("y", "z", "height")
    figure, _ = page(problem(), solution, labels, [thrust, tilt], place=lambda x: x[:, [2, 3, 1]])
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("rocket_landing", solution, REFERENCE, draw(solution))
