"""The Lagrangian of the nonlinear problem: its multipliers, and the augmented form that judges steps.

    L = sum_i cost_i + terminal cost + lambda_i . (F_i(w_i) - x_{i+1}) - sum y . g(w_i)

with F the flow over an interval and g in K the constraint values at its points.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import Cone, NonNegative, SecondOrder
from jaxscp.core.types import Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem, end_condition, start_condition, terminal_cost
from jaxscp.transcription.inequalities import inequalities
from jaxscp.transcription.shooting import Grid, Outputs, active_points, evaluate


def no_multipliers(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Multipliers:
    """Zeros."""

    def like(z):
        outputs, n = evaluate(problem, z, grid), problem.state_size
        initial, final = start_condition(problem, z[0, :n]), end_condition(problem, z[-1, :n])
        return Multipliers(outputs.end, initial, final, inequalities(problem, z, outputs))

    return jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(like, z))


def lagrangian(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    outputs: Outputs,
    y: Multipliers,
    room: float = 0.0,
) -> Scalar:
    """L at a point, of which ``outputs`` are the intervals'; ``room`` is added to every inequality."""
    n = problem.state_size
    total = jnp.sum(outputs.cost) + terminal_cost(problem, z)
    total += jnp.vdot(y.flow, outputs.end - z[1:, :n])
    total += jnp.vdot(y.initial, start_condition(problem, z[0, :n]))
    total += jnp.vdot(y.final, end_condition(problem, z[-1, :n]))
    return total - sum(map(jnp.vdot, y.values, inequalities(problem, z, outputs, room)), jnp.zeros(()))


class Residual(eqx.Module):
    """What a point lacks of feasibility, and its cost: all that the merit needs to know of it."""

    cost: Scalar
    """Running and terminal."""
    defect: Float[Array, "intervals states"]
    """F(w_i) - x_{i+1}."""
    values: tuple[Float[Array, "intervals _ _"], ...]


def residual(outputs: Outputs, terminal: Scalar, z: Float[Array, "nodes variables"]) -> Residual:
    """Residual of a point from its intervals' outputs and its terminal cost."""
    defect = outputs.end - z[1:, : outputs.end.shape[1]]
    return Residual(jnp.sum(outputs.cost) + terminal, defect, outputs.values)


def merit(
    problem: OptimalControlProblem,
    r: Residual,
    y: Multipliers,
    weight: float,
    scale: Float[Array, "states"],
) -> Scalar:
    """Augmented Lagrangian of a point (Rockafellar's form for the cones).

    An exact penalty would count the defect a step leaves, which is of second order, at the full price of its
    multiplier, whatever its sign, and so refuse good steps (Maratos effect); this one does not.

    Args:
        problem: gives the constraints' cones and where they are active.
        r: the point.
        y: multipliers, the same for all points that are compared.
        weight: of the squared residuals.
        scale: (states,) by which a defect is divided.
    """
    total = r.cost + jnp.vdot(y.flow, r.defect) + 0.5 * weight * jnp.sum((r.defect / scale) ** 2)
    for constraint, values, multiplier in zip(problem.constraints, r.values, y.by_interval(), strict=True):
        pull = projection(constraint.cone, multiplier - weight * values)
        terms = (pull * pull - multiplier * multiplier) / (2.0 * weight)
        active = active_points(constraint, values.shape[1])
        total += jnp.sum(jnp.where(active[:, :, None], terms, 0.0))
    return total


def worst_violation(problem: OptimalControlProblem, r: Residual) -> Scalar:
    """Largest violation of a constraint at its points, in the unit of its values; zero if there is none."""
    worst = jnp.zeros(())
    for constraint, values in zip(problem.constraints, r.values, strict=True):
        lack = -slack(constraint.cone, values)
        active = active_points(constraint, values.shape[1])[:, :, None]
        worst = jnp.maximum(worst, jnp.max(jnp.where(active, lack, 0.0), initial=0.0))
    return worst


def projection(cone: Cone, v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """Nearest point of a cone's dual (which is the cone itself, or everything for an equality)."""
    if isinstance(cone, NonNegative):
        return jnp.maximum(v, 0.0)
    if not isinstance(cone, SecondOrder):
        return v
    head, norm = v[..., :1], jnp.linalg.norm(v[..., 1:], axis=-1, keepdims=True)
    middle = 0.5 * (head + norm)
    between = jnp.concatenate([middle, middle * v[..., 1:] / jnp.maximum(norm, 1e-12)], axis=-1)
    return jnp.where(norm <= head, v, jnp.where(norm <= -head, 0.0, between))


def slack(cone: Cone, values: Float[Array, "*b rows"]) -> Float[Array, "*b scalars"]:
    """Distance to the boundary of every scalar condition: one a row, or one for a second-order cone."""
    if isinstance(cone, SecondOrder):
        return values[..., :1] - jnp.linalg.norm(values[..., 1:], axis=-1, keepdims=True)
    return values if isinstance(cone, NonNegative) else -jnp.abs(values)
