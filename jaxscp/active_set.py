"""The constraints that a subproblem ended on, as equalities of the interval's variables, in scaled units.

Near a solution the problem is curved upwards only along them, so whatever is done between subproblems (making
curvature convex, correcting a step to second order) has to hold them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.constraints import SecondOrder
from jaxscp.intervals import Linearisation, Outputs, active_points
from jaxscp.lagrangian import FlightMultipliers, slack
from jaxscp.problem import OptimalControlProblem
from jaxscp.types import Nodes

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
    multipliers: FlightMultipliers,
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """What a subproblem about ``linear`` ended on.

    Args:
        problem: gives the constraints.
        linear: where the subproblem was posed.
        multipliers: its own.
        scale: typical sizes of an interval's variables.
    """
    gradients, weights = [], []
    for constraint, values, jacobian, y in zip(
        problem.constraints,
        linear.outputs.values,
        linear.jacobian.values,
        multipliers.by_interval(),
        strict=True,
    ):
        gradient, price = _scalar_conditions(constraint.cone, values, jacobian, y)
        gradient = gradient * scale
        size = jnp.linalg.norm(gradient, axis=-1)
        on = (price * size > PULL) & active_points(constraint, values.shape[1])[:, :, None]
        gradients.append(gradient.reshape(gradient.shape[0], -1, gradient.shape[-1]))
        weights.append(on.reshape(on.shape[0], -1))
    gradient = jnp.concatenate(gradients, axis=1)
    size = jnp.maximum(jnp.linalg.norm(gradient, axis=-1), 1e-9)
    weight = jnp.concatenate(weights, axis=1).astype(gradient.dtype)
    at_limit = (multipliers.dilation > PULL).astype(gradient.dtype)
    return ActiveSet(gradient / size[..., None], size, weight, at_limit)


def near_limits(
    problem: OptimalControlProblem,
    linear: Linearisation,
    multipliers: FlightMultipliers,
    dilation: Nodes,
    scale: Float[Array, "inputs"],
) -> ActiveSet:
    """Whatever has less slack than ``NEAR`` left, whether or not it has a price."""
    free = jax.tree.map(jnp.zeros_like, multipliers)
    conditions = active_set(problem, linear, free, scale)
    on = [
        ((slack(c.cone, v) < NEAR) & active_points(c, v.shape[1])[:, :, None]).reshape(v.shape[0], -1)
        for c, v in zip(problem.constraints, linear.outputs.values, strict=True)
    ]
    at_limit = jnp.minimum(dilation - problem.dilation_min, problem.dilation_max - dilation) < NEAR
    weight = jnp.concatenate(on, axis=1).astype(dilation.dtype)
    return ActiveSet(conditions.gradient, conditions.size, weight, at_limit.astype(dilation.dtype))


def slacks(problem: OptimalControlProblem, outputs: Outputs) -> Float[Array, "intervals conditions"]:
    """The conditions' values at a point, in the order of an ``ActiveSet``."""
    parts = [slack(c.cone, v) for c, v in zip(problem.constraints, outputs.values, strict=True)]
    return jnp.concatenate([part.reshape(part.shape[0], -1) for part in parts], axis=1)


def nearest_dilation_limit(problem: OptimalControlProblem, dilation: Nodes) -> Nodes:
    """The limit that each node's dilation is nearer to."""
    middle = 0.5 * (problem.dilation_min + problem.dilation_max)
    return jnp.where(dilation < middle, problem.dilation_min, problem.dilation_max)


def _scalar_conditions(cone, values, jacobian, y):
    """Gradients of every scalar condition, and their prices."""
    if not isinstance(cone, SecondOrder):
        return jacobian, jnp.abs(y)
    norm = jnp.linalg.norm(values[..., 1:], axis=-1, keepdims=True)
    unit = values[..., 1:] / jnp.maximum(norm, 1e-6)
    gradient = jacobian[..., :1, :] - jnp.einsum("...k,...kw->...w", unit, jacobian[..., 1:, :])[..., None, :]
    return gradient, y[..., :1]
