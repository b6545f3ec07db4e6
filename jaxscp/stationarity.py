"""How far a point is from one of Karush, Kuhn and Tucker, where the gradient of the Lagrangian is zero:

    grad(cost) + sum_i lambda_i' dF_i - sum y' dg = 0,        lambda free, y in the dual of the constraint's cone,

with F the flow over an interval and g the values of the constraints at its points.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic import kkt
from jaxscp.conic.program import Multipliers
from jaxscp.intervals import Linearisation
from jaxscp.lifted import lifted_program
from jaxscp.problem import OptimalControlProblem
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
    size = jnp.maximum(jnp.max(jnp.abs(z), axis=0), 1.0)
    size = jnp.concatenate([size, size[problem.state_size :]])
    gradient = lagrangian_gradient(problem, z, linear, multipliers)
    return jnp.max(jnp.abs(gradient * size)) / jnp.maximum(1.0, jnp.abs(cost))


def lagrangian_gradient(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    multipliers: Multipliers,
) -> Float[Array, "nodes inputs"]:
    """By stages w_i = (x_i, U_i, U_{i+1}): two stages that share a node's controls each have a share of its part."""
    inputs = linear.jacobian.end.shape[-1]
    flat = jnp.zeros((problem.nodes, inputs, inputs), z.dtype)
    program = lifted_program(problem, z, linear, flat, flat[:, 0], jnp.inf)
    gradient = program.gradient + kkt.transpose(program, multipliers)
    return gradient[:, :inputs]  # without the virtual buffer
