"""Symmetric cones: products, distances to the boundary and Nesterov-Todd scalings.

A point of the product cone is a ``ConeVector``: rows of the zero cone, of the nonnegative orthant, and
second-order cones {(t, v): |v| <= t} along the last axis, padded with zeros to one dimension so that one
batched operation serves them all. Formulas: Vandenberghe, "The CVXOPT linear and
quadratic cone program solvers" (2010), sections 4 and 5.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.second_order import (
    SecondOrderScaling,
    jordan_divide,
    jordan_product,
    second_order_scaling,
    step_to_boundary,
)
from jaxscp.core.types import Scalar


class ConeVector(eqx.Module):
    """A point of the product of zero cone, nonnegative orthant and second-order cones."""

    zero: Float[Array, "*zero"]
    orthant: Float[Array, "*orthant"]
    second: Float[Array, "cones dimension"]


class Scaling(eqx.Module):
    """Nesterov-Todd scaling of the whole product cone; zero on the zero cone, whose slack is always zero."""

    orthant: Float[Array, "*orthant"]
    second: SecondOrderScaling

    def apply(self, v: ConeVector) -> ConeVector:
        """W v."""
        return ConeVector(jnp.zeros_like(v.zero), self.orthant * v.orthant, self.second.apply(v.second))

    def apply_inverse(self, v: ConeVector) -> ConeVector:
        """W^-1 v."""
        return ConeVector(
            jnp.zeros_like(v.zero), v.orthant / self.orthant, self.second.apply_inverse(v.second)
        )

    def square(self, v: ConeVector) -> ConeVector:
        """W^2 v."""
        return ConeVector(jnp.zeros_like(v.zero), self.orthant**2 * v.orthant, self.second.square(v.second))


def scaling(s: ConeVector, y: ConeVector) -> Scaling:
    """Nesterov-Todd scaling of an interior pair of slack s and multiplier y."""
    return Scaling(jnp.sqrt(s.orthant / y.orthant), second_order_scaling(s.second, y.second))


def product(a: ConeVector, b: ConeVector) -> ConeVector:
    """Jordan product a o b; zero on the zero cone."""
    return ConeVector(jnp.zeros_like(a.zero), a.orthant * b.orthant, jordan_product(a.second, b.second))


def divide(a: ConeVector, b: ConeVector) -> ConeVector:
    """The u with a o u = b; zero on the zero cone."""
    return ConeVector(jnp.zeros_like(a.zero), b.orthant / a.orthant, jordan_divide(a.second, b.second))


def identity(like: ConeVector) -> ConeVector:
    """The identity e of the Jordan product; zero on the zero cone."""
    head = jnp.zeros_like(like.second).at[:, 0].set(1.0)
    return ConeVector(jnp.zeros_like(like.zero), jnp.ones_like(like.orthant), head)


def degree(like: ConeVector) -> int:
    """Number of complementarity pairs: one a half-space, one a second-order cone."""
    return like.orthant.size + like.second.shape[0]


def longest_step(point: ConeVector, direction: ConeVector) -> Scalar:
    """Largest step, at most 1e3, that keeps a point in the cone."""
    along = jnp.where(direction.orthant < 0, -point.orthant / direction.orthant, jnp.inf)
    second = step_to_boundary(point.second, direction.second)
    return jnp.minimum(jnp.min(along, initial=1e3), jnp.min(second, initial=1e3))


def lift_inside(point: ConeVector) -> ConeVector:
    """Move every cone's part at least one unit inside its cone; the zero cone's part is kept."""
    norm = jnp.linalg.norm(point.second[:, 1:], axis=1)
    head = jnp.maximum(point.second[:, 0], norm + 1.0)
    return ConeVector(point.zero, jnp.maximum(point.orthant, 1.0), point.second.at[:, 0].set(head))
