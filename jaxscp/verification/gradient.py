"""The judge's own gradient of the Lagrangian: every interval flown again by an eighth-order method that the solver does
not use, and differentiated in reverse."""

import jax
from jaxtyping import Array, Float

from jaxscp.integration import in_jax
from jaxscp.integration.intervals import Intervals
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.transcription.lagrangian import lagrangian
from jaxscp.transcription.layout import interval_inputs
from jaxscp.transcription.shooting import Grid, Outputs, given, intervals_of, outputs
from jaxscp.verification.integrator.method import eighth_order


def reflown_gradient(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> Float[Array, "nodes variables"]:
    """Of the Lagrangian, with respect to the node variables."""
    return jax.grad(lambda z: lagrangian(problem, z, reflown(problem, z, grid), y))(z)


def reflown(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """What ``intervals.evaluate`` says, by one step of the method for every stretch between two points."""
    ours = intervals_of(problem, grid)
    theirs = Intervals(ours.rate, ours.states, eighth_order(), grid.points, 1, ours.path_outputs)
    return outputs(problem, in_jax.evaluate(theirs, interval_inputs(problem, z), given(problem, grid)))
