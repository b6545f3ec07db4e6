"""The judge's own gradient of the Lagrangian: every interval flown again by an eighth-order method that the solver does
not use, and differentiated in reverse."""

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxscp import runge_kutta
from jaxscp.discretise import interval_inputs
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
    theirs = Intervals(ours.rate, ours.states, _eighth_order(), grid.points, 1, ours.watch)
    return outputs(problem, in_jax.outcomes(theirs, interval_inputs(problem, z), given(problem, grid)))


def _eighth_order() -> runge_kutta.Method:
    """Dormand and Prince's, by diffrax's table."""
    from diffrax import Dopri8  # slow to import

    tableau = Dopri8.tableau
    table = np.zeros((tableau.num_stages, tableau.num_stages))
    for stage, row in enumerate(tableau.a_lower, start=1):
        table[stage, :stage] = row
    return runge_kutta.Method(np.append(0.0, tableau.c), np.asarray(tableau.b_sol), table)
