"""First-order optimality conditions (Karush, Kuhn and Tucker): the gradient of the Lagrangian is zero.

    grad(cost) + sum_i lambda_i' dF_i - sum y' dg = 0,        lambda free, y in the dual of the constraint's cone,

with F the flow over an interval, lambda also of the conditions at both ends, and g the values of the constraints.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import jacobians, transpose_product
from jaxscp.transcription.layout import cost_gradient, sum_onto_nodes
from jaxscp.transcription.shooting import Linearisation


def stationarity(
    gradient: Float[Array, "nodes variables"], z: Float[Array, "nodes variables"], cost: Scalar
) -> Scalar:
    """Largest component of the Lagrangian's gradient, times the variable's typical size, relative to the cost.

    To first order, this fraction of the cost would be gained if one variable changed by its own size.

    Args:
        gradient: of the Lagrangian at the point.
        z: node variables of the point.
        cost: of the point.
    """
    return jnp.max(jnp.abs(gradient * typical_sizes(z))) / jnp.maximum(1.0, jnp.abs(cost))


def lagrangian_gradient(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    y: Multipliers,
) -> Float[Array, "nodes variables"]:
    """Gradient of the Lagrangian with respect to the node variables."""
    equalities = equalities_gradient(problem, z, linear, y)
    return equalities - transpose_product(problem, jacobians(problem, z, linear), y.values)


def equalities_gradient(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    y: Multipliers,
) -> Float[Array, "nodes variables"]:
    """The same gradient without the inequalities."""
    n = problem.state_size
    gradient = cost_gradient(problem, z, linear.jacobian.cost)
    intervals = gradient[:-1] + jnp.einsum("isw,is->iw", linear.jacobian.end, y.flow)
    nodes = sum_onto_nodes(problem, intervals).at[1:, :n].add(-y.flow)
    nodes = nodes.at[-1].add(gradient[-1, : problem.variables])
    nodes = nodes.at[0, :n].add(linear.initial.jacobian.T @ y.initial)
    return nodes.at[-1, :n].add(linear.final.jacobian.T @ y.final)
