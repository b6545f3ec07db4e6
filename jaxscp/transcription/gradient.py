"""The gradient of the Lagrangian by a given integration method, in JAX alone: a check on ``stationarity``."""

import jax
from jaxtyping import Array, Float

from jaxscp.integration import in_jax
from jaxscp.integration.intervals import Intervals
from jaxscp.integration.tableaus import Method
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.interval_inputs import integration_inputs
from jaxscp.transcription.lagrangian import lagrangian
from jaxscp.transcription.shooting import (
    Grid,
    Outputs,
    by_constraint,
    interval_data,
    intervals_of,
    with_quadratic_cost,
)


def gradient_by(
    method: Method,
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    y: Multipliers,
    grid: Grid,
) -> Float[Array, "nodes variables"]:
    """Gradient of the Lagrangian with respect to the node variables, in reverse mode.

    Args:
        method: of integration; the verifier gives one that the solver does not use.
        problem: that was solved.
        z: node variables.
        y: multipliers.
        grid: subintervals of an interval.
    """
    return jax.grad(lambda z: lagrangian(problem, z, outputs_by(method, problem, z, grid), y))(z)


def outputs_by(
    method: Method, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Outputs:
    """The outputs of ``shooting.evaluate``, by one step of a method over every subinterval."""
    usual = intervals_of(problem, grid)
    intervals = Intervals(usual.rate, usual.states, method, grid.subintervals, 1, usual.path_outputs)
    outputs = in_jax.evaluate(intervals, integration_inputs(problem, z), interval_data(problem, grid))
    return with_quadratic_cost(problem, z, by_constraint(problem, outputs))
