"""The optimum as a smooth function of the problem: a point of the central path.

    minimise    cost(z) - mu sum log det g(z)
    subject to  F_i(w_i) = x_{i+1},  conditions at both ends

with F the flow over an interval, g in K the values of the inequalities and det the determinant of the cone K (a value
itself, or t^2 - |v|^2). As mu falls to zero this becomes the optimum itself (Nesterov and Nemirovskii, "Interior-point
polynomial algorithms in convex programming", 1994); at a small mu it costs about mu more for each inequality that holds
with equality, and each of those keeps mu / price away from its limit. Unlike the optimum it has derivatives also where
a limit is just about to matter, and where several say the same.

With prices y of the inequalities as unknowns of their own, -mu log det g is the most, over y, of mu log det y - y . g,
but for a constant. One function, the Lagrangian

    cost(z) + lambda . (F(w) - x) + mu sum log det y - y . g(z),

then serves the tests and the implicit function theorem (``sensitivity``): at the optimum its gradient in all unknowns
is zero. In this form no price is the quotient of mu and of a distance that rounding has a share in.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import Cone, SecondOrder
from jaxscp.core.types import Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.transcription.inequalities import cones
from jaxscp.transcription.lagrangian import lagrangian as multiplied
from jaxscp.transcription.shooting import Grid, evaluate

MU = 1e-6  # of the answer: a limit of unit price is kept a micrometre, or micronewton, away from
ROOM = 1e-6  # added to every value, so that a condition at an end may lie on a limit


class Point(eqx.Module):
    """All unknowns: node variables, and multipliers."""

    z: Float[Array, "nodes variables"]
    y: Multipliers


def lagrangian(problem: OptimalControlProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Scalar:
    """Cost, equalities and inequalities times their multipliers, and barrier of the latter."""
    total = multiplied(problem, point.z, evaluate(problem, point.z, grid), point.y, ROOM)
    for cone, price in zip(cones(problem), point.y.values, strict=True):
        total += mu * jnp.sum(log_det(cone, price))
    return total


def conditions(problem: OptimalControlProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Point:
    """Zero at the optimum: the Lagrangian's gradient. The multipliers' part of it is what the equalities lack, and how
    far the values are from mu over their prices."""
    return jax.grad(lagrangian, argnums=1)(problem, point, grid, mu)


def log_det(cone: Cone, values: Float[Array, "*b rows"]) -> Float[Array, "*b"]:
    """Logarithm of the determinant, halved for a second-order cone: one complementary pair then counts as one."""
    if not isinstance(cone, SecondOrder):
        return jnp.sum(jnp.log(values), axis=-1)
    # the difference of the squares, as t^2 (1 - |v / t|^2): smooth at the axis, where |v| is not
    ratio = values[..., 1:] / values[..., :1]
    return jnp.log(values[..., 0]) + 0.5 * jnp.log1p(-jnp.sum(ratio * ratio, axis=-1))


def inverse(cone: Cone, values: Float[Array, "*b rows"]) -> Float[Array, "*b rows"]:
    """In the cone's Jordan algebra; minus the gradient of ``-log_det``."""
    return jax.grad(lambda v: jnp.sum(log_det(cone, v)))(values)
