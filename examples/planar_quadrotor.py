"""A quadrotor in a vertical plane flies below one disc and above the next, in little time and with little thrust.

Reference: IPOPT on the same transcription, the best of four starts.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from matplotlib.patches import Circle

import jaxscp as js
from examples.drawing import OBSTACLE, History, page
from examples.support import ipopt, show

MASS, ARM, INERTIA, GRAVITY = 0.5, 0.15, 0.005, 9.81  # kg, m, kg m^2, m/s^2
MOST = 6.0  # N for each rotor
DISCS = jnp.array([[2.0, 1.3, 0.8], [4.0, 0.7, 0.8]])  # centres and radii in m


def quadrotor(x, u, t, p):  # x = (px, pz, pitch, vx, vz, rate), u = thrusts of both rotors
    force = (u[0] + u[1]) / MASS
    return jnp.stack(
        [*x[3:], -force * jnp.sin(x[2]), force * jnp.cos(x[2]) - GRAVITY, ARM * (u[1] - u[0]) / INERTIA]
    )


def outside(x, u, t, growth):
    return jnp.linalg.norm(x[:2] - DISCS[:, :2], axis=1) - growth * DISCS[:, 2]


def problem(growth=1.0):
    return js.OptimalControlProblem(
        dynamics=js.Dynamics.of(quadrotor, states=6, controls=2),
        cost=js.Cost(running=lambda x, u, t, p: 1.0 + 0.02 * u @ u),
        boundary=js.Boundary(
            js.fixed_state([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), js.fixed_state([6.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        ),
        time=js.Time(nodes=40, final=js.FreeTime(0.5, 10.0)),
        constraints=(js.bounds(control=(0.0, MOST)), js.Constraint(outside, js.NonNegative(), growth)),
    )


def guess(problem):
    hover = 0.5 * MASS * GRAVITY
    return js.straight_line(problem, final_time=3.0, control=[hover, hover])


# --- what to expect ---

REFERENCE = ipopt(2.920664)


def draw(solution):
    """The path between both discs."""
    thrust = History("thrusts in N", lambda x, u: u, limits=(0.0, MOST))
    pitch = History("pitch in rad", lambda x, u: x[:, 2])
    figure, path = page(problem(), solution, ("x in m", "z in m"), [thrust, pitch])
    for x, z, radius in DISCS:
        path.add_patch(Circle((x, z), radius, **OBSTACLE))
    path.axis("equal")
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("planar_quadrotor", solution, REFERENCE, draw(solution))
