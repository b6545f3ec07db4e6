"""The optimum as a smooth function of the problem: a point of the central path.

    minimise    cost(z) - mu sum log det g(z)
    subject to  F_i(w_i) = x_{i+1},  conditions at both ends

with F the flow over an interval, g in K the values of the inequalities and det the determinant of the cone K (a value
itself, or t^2 - |v|^2). As mu falls to zero this becomes the optimum itself (Nesterov and Nemirovskii, "Interior-point
polynomial algorithms in convex programming", 1994); at a small mu it costs about mu more for each inequality that holds
with equality, and each of those keeps mu / price away from its limit. Unlike the optimum it has derivatives also where
a limit is just about to matter, and where several say the same.

One function, the Lagrangian of this problem, serves the iterations (``interior``), the tests and the implicit function
theorem (``sensitivity``): at the optimum its gradient in all unknowns is zero.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.constraints import Cone, SecondOrder
from jaxscp.convexify import terminal_cost
from jaxscp.inequalities import cones, inequalities
from jaxscp.intervals import Grid, evaluate
from jaxscp.lagrangian import FlightMultipliers
from jaxscp.problem import OptimalControlProblem, end_condition, start_condition
from jaxscp.types import Scalar

MU = 1e-6  # of the answer: a limit of unit price is kept a micrometre, or micronewton, away from
ROOM = 1e-6  # added to every value, so that a condition at an end may lie on a limit


class Point(eqx.Module):
    """All unknowns: node variables, and the multipliers of the equalities. Those of inequalities follow from them."""

    z: Float[Array, "nodes variables"]
    flow: Float[Array, "intervals states"]
    """lambda: of F(w_i) = x_{i+1}."""
    initial: Float[Array, "initial"]
    """Of the conditions at the start."""
    final: Float[Array, "final"]
    """Of the conditions at the end."""


def lagrangian(problem: OptimalControlProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Scalar:
    """Cost, equalities times their multipliers, and barrier."""
    z, n = point.z, problem.state_size
    outputs = evaluate(problem, z, grid)
    total = jnp.sum(outputs.cost) + terminal_cost(problem, z)
    total += jnp.vdot(point.flow, outputs.end - z[1:, :n])
    total += jnp.vdot(point.initial, start_condition(problem, z[0, :n])[1])
    total += jnp.vdot(point.final, end_condition(problem, z[-1, :n])[1])
    for cone, values in zip(cones(problem), inequalities(problem, z, outputs, ROOM), strict=True):
        total -= mu * jnp.sum(log_det(cone, values))
    return total


def conditions(problem: OptimalControlProblem, point: Point, grid: Grid, mu: Scalar | float = MU) -> Point:
    """Zero at the optimum: the Lagrangian's gradient in the node variables, and what the equalities lack."""
    return jax.grad(lagrangian, argnums=1)(problem, point, grid, mu)


def multipliers(
    problem: OptimalControlProblem, point: Point, grid: Grid, mu: Scalar | float = MU
) -> FlightMultipliers:
    """All multipliers of a point of the central path: an inequality's is mu times its value's inverse."""
    values = inequalities(problem, point.z, evaluate(problem, point.z, grid), ROOM)
    prices = tuple(mu * inverse(cone, v) for cone, v in zip(cones(problem), values, strict=True))
    return FlightMultipliers(point.flow, point.initial, point.final, prices)


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
