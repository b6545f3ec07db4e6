"""The motion from rest to rest over one metre in two seconds with the least integral of the squared acceleration.

Reference: a cubic in time, 12 distance^2 / duration^3: 1.5 m^2/s^3.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jaxscp as js
from examples.drawing import History, page
from examples.support import exact, show


def problem(duration=2.0):
    return js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(1),
        cost=js.Cost(running=lambda x, u, t, p: u @ u),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0])),
        time=js.Time(nodes=11, final=js.FixedTime(duration)),
    )


def guess(problem):
    return js.straight_line(problem)


# --- what to expect ---


def closed_form(duration):
    """The integral of (6 / T^2 (1 - 2 t / T))^2."""
    return 12.0 / duration**3


REFERENCE = exact(closed_form(2.0), "cubic in time")


def draw(solution):
    """The phase plane, and both histories."""
    acceleration = History("acceleration in m/s²", lambda x, u: u[:, 0])
    position = History("position in m", lambda x, u: x[:, 0])
    figure, _ = page(problem(), solution, ("position in m", "velocity in m/s"), [acceleration, position])
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("minimum_energy", solution, REFERENCE, draw(solution))
