"""How far a point is from one of Karush, Kuhn and Tucker, where the gradient of the Lagrangian is zero:

    grad(cost) + sum_i lambda_i' dF_i - sum y' dg = 0,        lambda free, y in the dual of the constraint's cone,

with F the flow over an interval, lambda also of the conditions at both ends, and g the values of the constraints.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem, typical_sizes
from jaxscp.transcription.inequalities import jacobians, pulled
from jaxscp.transcription.layout import cost_gradient, onto_nodes
from jaxscp.transcription.shooting import Linearisation


def stationarity(
    gradient: Float[Array, "nodes variables"], z: Float[Array, "nodes variables"], cost: Scalar
) -> Scalar:
    """Largest component of the Lagrangian's gradient, each times the variable's typical size, relative to the cost:
    to first order, the share of the cost that changing one variable by its own size would still gain.

    Args:
        gradient: of the Lagrangian at the point.
        z: node variables of the point.
        cost: of the point.
    """
    return jnp.max(jnp.abs(gradient * typical_sizes(z))) / jnp.maximum(1.0, jnp.abs(cost))


def lagrangian_gradient(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    y: Multipliers,
) -> Float[Array, "nodes variables"]:
    """With respect to the node variables."""
    equalities = equalities_gradient(problem, z, linear, y)
    return equalities - pulled(problem, jacobians(problem, z, linear), y.values)


def equalities_gradient(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    y: Multipliers,
) -> Float[Array, "nodes variables"]:
    """The same without the inequalities."""
    n = problem.state_size
    gradient = cost_gradient(problem, z, linear.jacobian.cost)
    intervals = gradient[:-1] + jnp.einsum("isw,is->iw", linear.jacobian.end, y.flow)
    nodes = onto_nodes(problem, intervals).at[1:, :n].add(-y.flow)
    nodes = nodes.at[-1].add(gradient[-1, : problem.variables])
    nodes = nodes.at[0, :n].add(linear.initial.jacobian.T @ y.initial)
    return nodes.at[-1, :n].add(linear.final.jacobian.T @ y.final)
