"""The optimum as a smooth function of the problem: a point of the central path.

    minimise    cost(z) - mu sum log det g(z)
    subject to  F_i(w_i) = x_{i+1},  conditions at both ends

F is the flow over an interval, g in K are the values of the inequalities, and det is the determinant of the cone K (a
value itself, or t^2 - |v|^2). As mu falls to zero this becomes the optimum itself (Nesterov and Nemirovskii,
"Interior-point polynomial algorithms in convex programming", 1994). At a small mu the cost rises by about mu for each
active inequality, which stays mu / multiplier away from its limit. Unlike the optimum, the point has
derivatives also where a constraint is weakly active, and where constraints are redundant.

With multipliers y of the inequalities as unknowns, -mu log det g is the maximum over y of mu log det y - y . g, up to a
constant. One function, the Lagrangian

    cost(z) + lambda . (F(w) - x) + mu sum log det y - y . g(z),

then serves the tests and the implicit function theorem (``sensitivity``): at the optimum its gradient in all unknowns
is zero. In this form no multiplier is the quotient of mu and a rounded distance.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import cones
from jaxscp.transcription.lagrangian import lagrangian as without_barrier
from jaxscp.transcription.shooting import Grid, evaluate

MU = 1e-6  # of the solution: a limit with a multiplier of one is kept 1e-6 of its unit away
RELAXATION = 1e-6  # added to every value, so that an end condition may lie on a limit


class Point(eqx.Module):
    """All unknowns: node variables, and multipliers."""

    z: Float[Array, "nodes variables"]
    y: Multipliers


def lagrangian(problem: ScaledTimeProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Scalar:
    """Lagrangian of cost, equalities and inequalities, and the barrier of the multipliers."""
    total = without_barrier(problem, point.z, evaluate(problem, point.z, grid), point.y, RELAXATION)
    for cone, multiplier in zip(cones(problem), point.y.values, strict=True):
        total -= mu * jnp.sum(cone.log_barrier(multiplier))
    return total


def conditions(problem: ScaledTimeProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Point:
    """Optimality conditions, zero at the optimum: the gradient of the Lagrangian.

    Its part for the multipliers holds the residuals of the equalities, and mu y^-1 - g of the inequalities.
    """
    return jax.grad(lagrangian, argnums=1)(problem, point, grid, mu)
