"""The Lagrangian of the nonlinear problem, and the augmented Lagrangian that serves as merit function.

    L = sum_i cost_i + terminal cost + lambda_i . (F_i(w_i) - x_{i+1}) - sum y . g(w_i)

with F the flow over an interval and g in K the constraint values at its points.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.end_conditions import end_residuals
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import inequalities
from jaxscp.transcription.shooting import Grid, Outputs, evaluate


def no_multipliers(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Multipliers:
    """Multipliers of zero."""

    def like(z):
        outputs = evaluate(problem, z, grid)
        return Multipliers(outputs.end, *end_residuals(problem, z), inequalities(problem, z, outputs))

    return jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(like, z))


def lagrangian(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    outputs: Outputs,
    y: Multipliers,
    relaxation: float = 0.0,
) -> Scalar:
    """L at a point with the given outputs of its intervals; every inequality is moved inwards by ``relaxation``."""
    initial, final = end_residuals(problem, z)
    total = jnp.sum(outputs.cost) + problem.terminal_cost(z)
    total += jnp.vdot(y.flow, outputs.end - z[1:, : problem.state_size])
    total += jnp.vdot(y.initial, initial)
    total += jnp.vdot(y.final, final)
    return total - sum(map(jnp.vdot, y.values, inequalities(problem, z, outputs, relaxation)), jnp.zeros(()))


class Residual(eqx.Module):
    """Cost and residuals of a point: the arguments of the merit function."""

    cost: Scalar
    """Running and terminal."""
    defect: Float[Array, "intervals states"]
    """F(w_i) - x_{i+1}."""
    values: tuple[Float[Array, "intervals _ _"], ...]
    """Of the constraints, as in ``Outputs``."""
    initial: Float[Array, "initial"]
    """Of the conditions at the start."""
    final: Float[Array, "final"]
    """Of the conditions at the end."""

    @property
    def dynamics(self) -> Scalar:
        """Sum of the norms of the defects and of both ends' residuals."""
        defects = jnp.sum(jnp.linalg.norm(self.defect, axis=1))
        return defects + jnp.linalg.norm(self.initial) + jnp.linalg.norm(self.final)


def residual(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], outputs: Outputs) -> Residual:
    """Residual of a point with the given outputs of its intervals."""
    initial, final = end_residuals(problem, z)
    return Residual(
        cost=jnp.sum(outputs.cost) + problem.terminal_cost(z),
        defect=outputs.end - z[1:, : problem.state_size],
        values=outputs.values,
        initial=initial,
        final=final,
    )


class Merit(eqx.Module):
    """Augmented Lagrangian of a point (Rockafellar's form for the cones), from its residual.

    An exact penalty would count the second-order defect of a step at its full multiplier, whatever the sign, and so
    refuse good steps (Maratos effect). The augmented Lagrangian does not.
    """

    problem: ScaledTimeProblem
    multipliers: Multipliers
    """The same for all points that are compared."""
    weight: float
    """Of the squared residuals."""
    scale: Float[Array, "states"]
    """Typical sizes, by which a defect is divided."""

    def __call__(self, r: Residual) -> Scalar:
        """Merit of a point."""
        y, weight = self.multipliers, self.weight
        total = r.cost + jnp.vdot(y.flow, r.defect) + 0.5 * weight * jnp.sum((r.defect / self.scale) ** 2)
        for multiplier, end in ((y.initial, r.initial), (y.final, r.final)):
            total += jnp.vdot(multiplier, end) + 0.5 * weight * jnp.sum(end**2)
        for constraint, values, multiplier in zip(
            self.problem.constraints, r.values, y.by_interval(), strict=True
        ):
            projected = constraint.cone.project_dual(multiplier - weight * values)
            terms = (projected * projected - multiplier * multiplier) / (2.0 * weight)
            active = constraint.active_in_intervals(values.shape[1])
            total += jnp.sum(jnp.where(active[:, :, None], terms, 0.0))
        return total


def worst_violation(problem: ScaledTimeProblem, r: Residual) -> Scalar:
    """Largest violation of a constraint at its points, in the unit of its values; zero if there is none."""
    worst = jnp.zeros(())
    for constraint, values in zip(problem.constraints, r.values, strict=True):
        violation = -constraint.cone.margin(values)
        active = constraint.active_in_intervals(values.shape[1])[:, :, None]
        worst = jnp.maximum(worst, jnp.max(jnp.where(active, violation, 0.0), initial=0.0))
    return worst
