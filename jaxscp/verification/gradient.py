"""The verifier's own gradient of the Lagrangian, by an integration method that the solver does not use."""

import jax
from jaxtyping import Array, Float

from jaxscp.integration import in_jax
from jaxscp.integration.intervals import Intervals
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
from jaxscp.verification.integrator.method import eighth_order


def verified_gradient(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> Float[Array, "nodes variables"]:
    """Gradient of the Lagrangian with respect to the node variables, in reverse mode."""
    return jax.grad(lambda z: lagrangian(problem, z, integrated_outputs(problem, z, grid), y))(z)


def integrated_outputs(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """The outputs of ``shooting.evaluate``, by one eighth-order step of every subinterval."""
    ours = intervals_of(problem, grid)
    theirs = Intervals(ours.rate, ours.states, eighth_order(), grid.subintervals, 1, ours.path_outputs)
    outputs = in_jax.evaluate(theirs, integration_inputs(problem, z), interval_data(problem, grid))
    return with_quadratic_cost(problem, z, by_constraint(problem, outputs))
