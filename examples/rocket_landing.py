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
from jaxscp.dynamics.rotations import quaternion_rate, rotation_matrix

WET, DRY, BURN, LEAST, MOST, INERTIA = 2.0, 1.0, 0.05, 0.3, 5.0, 0.01
GIMBAL, TILT, SLOPE, RATE = np.deg2rad([20.0, 90.0, 20.0, 60.0])  # limits of angles and of the body rate
START = js.fixed_state([WET, 4.0, 4.0, 0.0, 0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
END = js.fixed_state([None, 0.0, 0.0, 0.0, -0.1, 0.0, 0.0, None, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


# x = (mass, position, velocity, quaternion, body rate), the first axis up; u = thrust
def rocket(x, u, t, p):
    acceleration = rotation_matrix(x[7:11]) @ u / x[0] - jnp.array([1.0, 0.0, 0.0])
    turn = jnp.append(quaternion_rate(x[7:11], x[11:]), jnp.cross(np.array([-0.01, 0, 0]), u) / INERTIA)
    return jnp.concatenate([-BURN * jnp.linalg.norm(u)[None], x[4:7], acceleration, turn])


def limits(x, u, t, most):
    size, tilted, rate = jnp.linalg.norm(u), x[9:11], x[11:]
    of_state = jnp.stack([x[0] - DRY, np.sin(TILT / 2.0) ** 2 - tilted @ tilted, RATE**2 - rate @ rate])
    return jnp.append(of_state, jnp.stack([size - LEAST, most - size, u[0] - np.cos(GIMBAL) * size]))


def problem(most=MOST):
    slope = lambda x, u, t, p: jnp.append(x[1] / np.tan(SLOPE), x[2:4])
    above = js.Constraint(slope, js.SecondOrder(), convex=True, active=np.arange(50) < 49)  # ends at its tip
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(rocket, states=14, controls=3),
        cost=js.Cost(terminal=lambda x, t, p: t),
        boundary=js.Boundary(START, END),
        time=js.Time(nodes=50, final=js.FreeTime(0.5, 20.0)),
        constraints=(js.Constraint(limits, js.NonNegative(), most), above),
    )


def guess(problem):
    return js.straight_line(problem, final_time=5.0, control=[WET, 0.0, 0.0])


# --- what to expect ---

REFERENCE = ipopt(6.00786514)


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
