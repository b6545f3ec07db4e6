"""Weighted rows of constraints, and their Gram matrices."""

import equinox as eqx
from jaxtyping import Array, Float


class WeightedRows(eqx.Module):
    """Jacobian of a constraint at all points of every location (a node or an interval), and weights of its rows.

    The weight matrix of a point is W = diag(weight) + rank_one rank_one', the form of a second-order cone's scaling.
    """

    jacobian: Float[Array, "locations points rows inputs"]
    """J."""
    weight: Float[Array, "locations points rows"]
    rank_one: Float[Array, "locations points rows"] | None
    """None for a diagonal weight matrix."""
    vectors: Float[Array, "locations points rows vectors"]
    """v; all constraints have equally many."""


class GramSums(eqx.Module):
    """Sums over constraints, points and rows, at every location."""

    matrix: Float[Array, "locations inputs inputs"]
    """J' W J."""
    products: Float[Array, "locations vectors inputs"]
    """J' v."""
