"""Weighted rows, and what they add up to."""

import equinox as eqx
from jaxtyping import Array, Float


class WeightedRows(eqx.Module):
    """The Jacobian of a constraint at every point of every place, and the weights of its rows: their matrix is
    diag(weight), and where there is an ``along`` also along along' over the rows of each point, as that of a
    second-order cone's scaling is."""

    jacobian: Float[Array, "places points rows inputs"]
    weight: Float[Array, "places points rows"]
    along: Float[Array, "places points rows"] | None
    sides: Float[Array, "places points rows sides"]
    """v, of which there may be several; as many for all constraints."""


class GramSums(eqx.Module):
    """Sums over the constraints."""

    matrix: Float[Array, "places inputs inputs"]
    """J' W J."""
    sides: Float[Array, "places sides inputs"]
    """J' v."""
