"""The constraints that a subproblem ended on, as equalities of the interval's variables, in scaled units.

Near a solution the problem is curved upwards only along them, so whatever is done between subproblems (making
curvature convex, correcting a step to second order) has to hold them.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from jaxscp.cones.cone import SecondOrder
from jaxscp.core.types import Nodes
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.transcription.lagrangian import slack
from jaxscp.transcription.shooting import Linearisation, Outputs, active_points

NEAR = 0.02  # slack, in a condition's own unit, below which a correction might use it up
PULL = 1e-4  # cost per unit of a (scaled) condition from which on it counts as active


class ActiveSet(eqx.Module):
    """Conditions gradient . w + slack = 0, weighted one where they are active and zero where not."""

    gradient: Float[Array, "intervals conditions inputs"]
    """Of unit length; with respect to scaled variables."""
    size: Float[Array, "intervals conditions"]
    """Length before; a slack is divided by it."""
    weight: Float[Array, "intervals conditions"]
    dilation: Nodes
    """One where a node's dilation is at its limit."""

    def curvature(self) -> Float[Array, "intervals inputs inputs"]:
        """Sum of weight gradient gradient'."""
        return jnp.einsum("icw,ic,icv->iwv", self.gradient, self.weight, self.gradient)

    def pull(self, slacks: Float[Array, "intervals conditions"]) -> Float[Array, "intervals inputs"]:
        """Gradient of the weighted squares of gradient . w + slack, halved, at w = 0."""
        return jnp.einsum("icw,ic->iw", self.gradient, self.weight * slacks / self.size)


def active_set(
    problem: OptimalControlProblem,
    linear: Linearisation,
    multipliers: Multipliers,
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """What a subproblem about ``linear`` ended on.

    Args:
        problem: gives the constraints.
        linear: where the subproblem was posed.
        multipliers: its own.
        scale: typical sizes of an interval's variables.
    """
    gradient, size = _gradients(problem, linear, scale)
    prices = [
        y[..., :1] if isinstance(c.cone, SecondOrder) else jnp.abs(y)
        for c, y in zip(problem.constraints, multipliers.by_interval(), strict=True)
    ]
    on = (_side_by_side(prices) * size > PULL) & _hold(problem, prices)
    at_limit = multipliers.dilation > PULL
    return ActiveSet(gradient, size, on.astype(size.dtype), at_limit.astype(size.dtype))


def near_limits(
    problem: OptimalControlProblem,
    linear: Linearisation,
    z: Float[Array, "nodes variables"],
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """Whatever has less slack than ``NEAR`` left at ``z``, where ``linear`` is, whether or not it has a price."""
    gradient, size = _gradients(problem, linear, scale)
    room = [slack(c.cone, v) for c, v in zip(problem.constraints, linear.outputs.values, strict=True)]
    on = (_side_by_side(room) < NEAR) & _hold(problem, room)
    dilation = z[:, -1]
    at_limit = jnp.minimum(dilation - problem.dilation_min, problem.dilation_max - dilation) < NEAR
    return ActiveSet(gradient, size, on.astype(size.dtype), at_limit.astype(size.dtype))


def slacks(problem: OptimalControlProblem, outputs: Outputs) -> Float[Array, "intervals conditions"]:
    """The conditions' values at a point, in the order of an ``ActiveSet``."""
    return _side_by_side([slack(c.cone, v) for c, v in zip(problem.constraints, outputs.values, strict=True)])


def nearest_dilation_limit(problem: OptimalControlProblem, dilation: Nodes) -> Nodes:
    """The limit that each node's dilation is nearer to."""
    middle = 0.5 * (problem.dilation_min + problem.dilation_max)
    return jnp.where(dilation < middle, problem.dilation_min, problem.dilation_max)


def _gradients(problem: OptimalControlProblem, linear: Linearisation, scale: Float[Array, "inputs"]):
    """Of every scalar condition, at unit length, and the length before."""
    parts = []
    for constraint, values, jacobian in zip(
        problem.constraints, linear.outputs.values, linear.jacobian.values, strict=True
    ):
        if isinstance(constraint.cone, SecondOrder):
            norm = jnp.linalg.norm(values[..., 1:], axis=-1, keepdims=True)
            unit = values[..., 1:] / jnp.maximum(norm, 1e-6)
            inward = jnp.einsum("ipk,ipkw->ipw", unit, jacobian[..., 1:, :])
            jacobian = (jacobian[..., 0, :] - inward)[..., None, :]
        parts.append(jacobian.reshape(jacobian.shape[0], -1, jacobian.shape[-1]))
    gradient = jnp.concatenate(parts, axis=1) * scale
    size = jnp.maximum(jnp.linalg.norm(gradient, axis=-1), 1e-9)
    return gradient / size[..., None], size


def _hold(problem: OptimalControlProblem, like: list[Array]) -> Bool[Array, "intervals conditions"]:
    """Whether each scalar condition holds at all, in the shape of a list by constraints."""
    return _side_by_side(
        [
            jnp.broadcast_to(active_points(c, v.shape[1])[:, :, None], v.shape)
            for c, v in zip(problem.constraints, like, strict=True)
        ]
    )


def _side_by_side(parts: list[Array]) -> Shaped[Array, "intervals conditions"]:
    return jnp.concatenate([part.reshape(part.shape[0], -1) for part in parts], axis=1)
