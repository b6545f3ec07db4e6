"""Exact discretisation under first-order hold by the state-transition matrix (equations 12-18).

Within an interval, control and dilation are linear in scaled time. RK4 integrates the end of the interval as a function
of (z_i, u_{i+1}). Its forward-mode derivative integrates the variational equations with the same steps (the
inverse-free form). So A, B- and B+ are the exact Jacobians of the discrete flow.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.integration import dispatch, tableaus
from jaxscp.integration.intervals import Intervals, controls_at, without_data
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.interval_inputs import QuadraticCost, in_variables, integration_inputs
from jaxscp.transcription.layout import interval_variables

METHOD = tableaus.CLASSICAL


class Discretisation(eqx.Module):
    """The flow over every interval, linearised about a reference: y = flow + jacobian (w - w_ref).

    w_i = (z_i, u_{i+1}) are an interval's variables, the dilation counted as a control.
    """

    state: Float[Array, "*intervals states"]
    """States at the end of each interval when integrated from its first node."""
    cost: Float[Array, "*intervals"]
    """Running cost of each interval."""
    state_jacobian: Float[Array, "*intervals states inputs"]
    """[A, B-, B+]."""
    cost_jacobian: Float[Array, "*intervals inputs"]


@eqx.filter_jit  # traced once for all calls of one program
def discretise(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], substeps: int
) -> Discretisation:
    """Linearise the flow over every interval about the reference z.

    Args:
        problem: gives dynamics and running cost.
        z: reference, (nodes, variables).
        substeps: RK4 steps an interval; the error falls with their fourth power.
    """
    found, jacobian = dispatch.linearise(*_integration(problem, z, substeps))
    cost, slope = found.cost, in_variables(problem, jacobian.cost)
    if (quadratic := QuadraticCost.of(problem)) is not None:
        variables = interval_variables(problem, z)
        cost, slope = cost + quadratic.value(variables), slope + quadratic.gradient(variables)
    return Discretisation(found.end, cost, in_variables(problem, jacobian.end), slope)


def served_by(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], substeps: int
) -> Int[Array, ""]:
    """Index into ``BACKENDS`` of the implementation that finds first derivatives."""
    return dispatch.served_by(*_integration(problem, z, substeps), order=1)


def _integration(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], substeps: int):
    w = integration_inputs(problem, z)
    intervals = Intervals(problem.slope, problem.state_size, METHOD, substeps, substeps)
    return intervals, w, without_data(intervals, w.shape[0])


def propagate(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], substeps: int):
    """End states and running costs of every interval, without derivatives."""
    n = problem.state_size

    def end(w):
        rate = lambda share, extended: problem.slope(extended[:n], controls_at(w, n, share))  # noqa: E731
        return tableaus.integrate(METHOD, rate, jnp.append(w[:n], 0.0), substeps)[-1]

    ends = jax.vmap(end)(integration_inputs(problem, z))
    return ends[:, :n], ends[:, n]
