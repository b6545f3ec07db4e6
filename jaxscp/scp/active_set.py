"""The active constraints of a subproblem, as equalities of the interval's variables, in scaled units.

Near a solution the problem is convex only along the active constraints. So convexification and second-order correction
penalise steps that leave them.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from jaxscp.core.types import Nodes
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.shooting import Linearisation, Outputs

NEAR_LIMIT = 0.02  # slack, in the unit of a condition, that a correction might use up
ACTIVE_MULTIPLIER = 1e-4  # cost per unit of a (scaled) condition, above which the condition is active


class ActiveSet(eqx.Module):
    """Conditions gradient . w + slack = 0, with weight one where active and zero where not."""

    gradient: Float[Array, "intervals conditions inputs"]
    """Of unit length; with respect to scaled variables."""
    size: Float[Array, "intervals conditions"]
    """Length before normalisation, by which a slack is divided."""
    weight: Float[Array, "intervals conditions"]
    dilation: Nodes
    """One where a node's dilation is at its limit."""

    def hessian(self) -> Float[Array, "intervals inputs inputs"]:
        """Sum of weight gradient gradient'."""
        return jnp.einsum("icw,ic,icv->iwv", self.gradient, self.weight, self.gradient)

    def penalty_gradient(
        self, slacks: Float[Array, "intervals conditions"]
    ) -> Float[Array, "intervals inputs"]:
        """Gradient of 1/2 sum weight (gradient . w + slack)^2 at w = 0."""
        return jnp.einsum("icw,ic->iw", self.gradient, self.weight * slacks / self.size)


def active_set(
    problem: ScaledTimeProblem,
    linear: Linearisation,
    multipliers: Multipliers,
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """Conditions with a multiplier.

    Args:
        problem: gives the constraints.
        linear: linearisation that the subproblem was posed about.
        multipliers: of the subproblem.
        scale: typical sizes of an interval's variables.
    """
    gradient, size = _gradients(problem, linear, scale)
    sizes = [
        c.cone.multiplier_size(y) for c, y in zip(problem.constraints, multipliers.by_interval(), strict=True)
    ]
    active = (_concatenated(problem, sizes) * size > ACTIVE_MULTIPLIER) & _enforced(problem, sizes)
    at_limit = multipliers.dilation > ACTIVE_MULTIPLIER
    return ActiveSet(gradient, size, active.astype(size.dtype), at_limit.astype(size.dtype))


def near_limits(
    problem: ScaledTimeProblem,
    linear: Linearisation,
    z: Float[Array, "nodes variables"],
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """Conditions with less slack than ``NEAR_LIMIT`` at ``z``, the point of ``linear``, with or without multiplier."""
    gradient, size = _gradients(problem, linear, scale)
    margins = [c.cone.margin(v) for c, v in zip(problem.constraints, linear.outputs.values, strict=True)]
    active = (_concatenated(problem, margins) < NEAR_LIMIT) & _enforced(problem, margins)
    dilation = z[:, -1]
    at_limit = jnp.minimum(dilation - problem.dilation_min, problem.dilation_max - dilation) < NEAR_LIMIT
    return ActiveSet(gradient, size, active.astype(size.dtype), at_limit.astype(size.dtype))


def slacks(problem: ScaledTimeProblem, outputs: Outputs) -> Float[Array, "intervals conditions"]:
    """Slacks of the conditions, in the order of an ``ActiveSet``."""
    margins = [c.cone.margin(v) for c, v in zip(problem.constraints, outputs.values, strict=True)]
    return _concatenated(problem, margins)


def nearest_dilation_limit(problem: ScaledTimeProblem, dilation: Nodes) -> Nodes:
    """The limit that each node's dilation is nearer to."""
    middle = 0.5 * (problem.dilation_min + problem.dilation_max)
    return jnp.where(dilation < middle, problem.dilation_min, problem.dilation_max)


def _gradients(problem: ScaledTimeProblem, linear: Linearisation, scale: Float[Array, "inputs"]):
    """Gradient of every condition, at unit length, and the length before."""
    parts = []
    for constraint, values, jacobian in zip(
        problem.constraints, linear.outputs.values, linear.jacobian.values, strict=True
    ):
        jacobian = constraint.cone.margin_jacobian(values, jacobian)
        parts.append(jacobian.reshape(jacobian.shape[0], -1, jacobian.shape[-1]))
    none = jnp.zeros((problem.nodes - 1, 0, scale.shape[0]), scale.dtype)
    gradient = jnp.concatenate(parts or [none], axis=1) * scale
    size = jnp.maximum(jnp.linalg.norm(gradient, axis=-1), 1e-9)
    return gradient / size[..., None], size


def _enforced(problem: ScaledTimeProblem, like: list[Array]) -> Bool[Array, "intervals conditions"]:
    """Whether each condition is enforced at all, in the shape of a list by constraints."""
    parts = [
        jnp.broadcast_to(c.active_in_intervals(v.shape[1])[:, :, None], v.shape)
        for c, v in zip(problem.constraints, like, strict=True)
    ]
    return _concatenated(problem, parts).astype(bool)


def _concatenated(problem: ScaledTimeProblem, parts: list[Array]) -> Shaped[Array, "intervals conditions"]:
    """Conditions of all constraints by intervals; no columns for a problem without constraints."""
    columns = [part.reshape(part.shape[0], -1) for part in parts]
    return jnp.concatenate(columns or [jnp.zeros((problem.nodes - 1, 0))], axis=1)
