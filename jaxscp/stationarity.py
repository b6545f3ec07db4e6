"""How far a point is from one of Karush, Kuhn and Tucker, where the gradient of the Lagrangian is zero:

    grad(cost) + sum_i lambda_i' dF_i - sum y' dg = 0,        lambda free, y in the dual of the constraint's cone,

with F the flow over an interval and g the values of the constraints at its points.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic import kkt
from jaxscp.conic.program import Multipliers
from jaxscp.intervals import Linearisation
from jaxscp.lifted import linear_program, stage_sizes
from jaxscp.problem import OptimalControlProblem, typical_sizes
from jaxscp.types import Scalar


def stationarity(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    multipliers: Multipliers,
    cost: Scalar,
) -> Scalar:
    """Largest component of the Lagrangian's gradient, each times the variable's typical size, relative to the cost:
    to first order, the share of the cost that changing one variable by its own size would still gain.

    Args:
        problem: what is asked.
        z: node variables of the point.
        linear: its intervals.
        multipliers: of the lifted subproblem that led to it.
        cost: of the point.
    """
    size = stage_sizes(problem, typical_sizes(z))
    gradient = lagrangian_gradient(problem, z, linear, multipliers)
    return jnp.max(jnp.abs(gradient * size)) / jnp.maximum(1.0, jnp.abs(cost))


def lagrangian_gradient(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    multipliers: Multipliers,
) -> Float[Array, "nodes inputs"]:
    """By stages w_i = (x_i, U_i, U_{i+1}): two stages that share a node's controls each have a share of its part."""
    program = linear_program(problem, z, linear)
    gradient = program.gradient + kkt.transpose(program, multipliers)
    return gradient[:, : linear.jacobian.end.shape[-1]]  # without the virtual buffer
