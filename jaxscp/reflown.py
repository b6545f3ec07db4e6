"""The judge's own gradient of the Lagrangian: every interval flown again by an eighth-order method that the solver does
not use, and differentiated in reverse."""

import jax
from jaxtyping import Array, Float

from jaxscp.discretise import interval_inputs
from jaxscp.flown.method import eighth_order
from jaxscp.intervals import Grid, Outputs, given, intervals_of, outputs
from jaxscp.lagrangian import lagrangian
from jaxscp.multipliers import FlightMultipliers
from jaxscp.problem import OptimalControlProblem
from jaxscp.sweeps import Intervals, in_jax


def reflown_gradient(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers, grid: Grid
) -> Float[Array, "nodes variables"]:
    """Of the Lagrangian, with respect to the node variables."""
    return jax.grad(lambda z: lagrangian(problem, z, reflown(problem, z, grid), y))(z)


def reflown(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """What ``intervals.evaluate`` says, by one step of the method for every stretch between two points."""
    ours = intervals_of(problem, grid)
    theirs = Intervals(ours.rate, ours.states, eighth_order(), grid.points, 1, ours.watch)
    return outputs(problem, in_jax.outcomes(theirs, interval_inputs(problem, z), given(problem, grid)))
