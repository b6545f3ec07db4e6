"""A quadrotor (rigid body, attitude as a quaternion, four thrusts) flies through three gates, in little time.

Each gate is a ball that one node must lie in. The mesh is free in time, so that the solver chooses when.

Reference: IPOPT on the same transcription, the best of four starts.
"""

import jax

jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp

import jaxscp as js
from examples.drawing import History, page
from examples.support import ipopt, show

GATES = jnp.array([[2.0, 1.5, 1.5], [4.0, -1.0, 2.5], [6.0, 1.0, 1.0]])  # m, passed in this order
RADIUS, EVERY = 0.2, 8  # m; intervals between two gates
QUADROTOR = js.airframes.paper_mav()


def within(x, u, t, gate):
    return RADIUS**2 - jnp.sum((x[:3] - gate) ** 2)[None]


def at_rest(position, turned):
    return js.fixed_state([*position, 0.0, 0.0, 0.0, turned, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def problem(stretch=1.0):
    node = jnp.arange(4 * EVERY + 1)
    passed = [
        js.Constraint(
            within, js.NonNegative(), gate, active=node == EVERY * k, where=js.AtNodes(), name=f"gate {k}"
        )
        for k, gate in enumerate(GATES * jnp.array([1.0, 1.0, stretch]), start=1)
    ]
    return js.OptimalControlProblem(
        dynamics=QUADROTOR.body,
        cost=js.Cost(running=lambda x, u, t, p: 1.0 + 0.01 * u @ u),
        boundary=js.Boundary(at_rest([0.0, 0.0, 1.0], 1.0), at_rest([8.0, 0.0, 1.0], None)),
        time=js.Time(nodes=node.size, final=js.FreeTime(1.0, 20.0)),
        constraints=(js.bounds(control=(QUADROTOR.thrust_min, QUADROTOR.thrust_max)), *passed),
    )


def guess(problem):
    return js.straight_line(problem, final_time=5.0, control=QUADROTOR.body.hover_thrust())


# --- what to expect ---

REFERENCE = ipopt(4.5301811)


def draw(solution):
    """The flight through the gates."""
    thrust = History(
        "thrusts in N", lambda x, u: u, limits=(QUADROTOR.thrust_min[0], QUADROTOR.thrust_max[0])
    )
    speed = History("speed in m/s", lambda x, u: jnp.linalg.norm(x[:, 3:6], axis=1))
    figure, path = page(problem(), solution, ("x in m", "y in m", "z in m"), [thrust, speed])
    path.scatter(*GATES.T, s=60, facecolor="none", edgecolor="0.4", depthshade=False)
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("gates", solution, REFERENCE, draw(solution))
