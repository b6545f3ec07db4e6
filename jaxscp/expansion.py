"""Intervals to second order, in one pass: outputs, Jacobians, and the curvature of the Lagrangian."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import sweeps
from jaxscp.discretise import interval_inputs
from jaxscp.intervals import (
    Grid,
    Linearisation,
    Outputs,
    active_points,
    given,
    intervals_of,
    linearisation,
    prices,
)
from jaxscp.multipliers import FlightMultipliers
from jaxscp.problem import OptimalControlProblem


@eqx.filter_jit  # traced once for all calls of one program
def expand(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers, grid: Grid
) -> tuple[Linearisation, Float[Array, "intervals inputs inputs"]]:
    """Every interval linearised, and the second derivatives of the Lagrangian, a block an interval.

    Nothing couples intervals but linearly. What holds at nodes alone, the conditions at both ends and the terminal cost
    have second derivatives of their own, which are left out.
    """
    held = tuple(  # on the central path, what does not hold has a price all the same
        jnp.where(active_points(c, v.shape[1])[:, :, None], -v, 0.0)
        for c, v in zip(problem.constraints, y.by_interval(), strict=True)
    )
    asked = prices(problem, Outputs(y.flow, jnp.ones(problem.nodes - 1, z.dtype), held))
    intervals, w = intervals_of(problem, grid), interval_inputs(problem, z)
    found, jacobian, curvature = sweeps.curved(intervals, w, given(problem, grid), asked)
    return linearisation(problem, z, found, jacobian), curvature
