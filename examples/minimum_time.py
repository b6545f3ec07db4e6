"""The fastest motion from rest to rest over one metre, with at most 2 m/s^2 of acceleration.

Reference: full acceleration to the middle, full braking from there: 2 sqrt(distance / limit), 1.4142 s.
"""

import jax

jax.config.update("jax_enable_x64", True)
import numpy as np

import jaxscp as js
from examples.drawing import History, page
from examples.support import exact, show

LIMIT = 2.0  # m/s^2


def problem(distance=1.0):
    return js.OptimalControlProblem(
        dynamics=js.DoubleIntegrator(1),
        cost=js.Cost(terminal=lambda x, t, p: t),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([distance, 0.0])),
        time=js.Time(nodes=21, final=js.FreeTime(0.05, 10.0)),
        constraints=(js.bounds(control=(-LIMIT, LIMIT)),),
    )


def guess(problem):
    return js.straight_line(problem, final_time=2.0)


# --- what to expect ---


def closed_form(distance):
    """Time of two parabolas."""
    return 2.0 * np.sqrt(distance / LIMIT)


REFERENCE = exact(closed_form(1.0), "two parabolas")


def draw(solution):
    """The phase plane, and both histories."""
    acceleration = History("acceleration in m/s²", lambda x, u: u[:, 0], limits=(-LIMIT, LIMIT))
    position = History("position in m", lambda x, u: x[:, 0])
    figure, _ = page(problem(), solution, ("position in m", "velocity in m/s"), [acceleration, position])
    return figure


if __name__ == "__main__":
    task = problem()
    solution = js.solve(task, guess(task))
    show("minimum_time", solution, REFERENCE, draw(solution))
