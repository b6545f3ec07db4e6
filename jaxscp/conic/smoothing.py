"""The projection onto a symmetric cone, smoothed: where a point of the central path lies, as a function of one vector.

A slack s and a multiplier y with s o y = mu e are known from their difference, the gap t = s - y. On the orthant

    s = (t + sqrt(t^2 + 4 mu)) / 2,    y = s - t = mu / s,

and on a second-order cone the same holds for the two spectral values of t, (t_0 + |t_1|) and (t_0 - |t_1|). At mu = 0
this is the projection of t onto the cone. Its derivative D = ds/dt is symmetric, has eigenvalues between zero and one,
and W^2 = D (I - D)^-1 is the square of the Nesterov-Todd scaling of the pair: on the central path, and there alone,
ds = -W^2 dy (Fukushima, Luo and Tseng, "Smoothing functions for second-order-cone complementarity problems", 2002).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector
from jaxscp.core.types import Scalar

_TINY = 1e-300  # keeps the direction of a tail of zeros finite


class Spectrum(eqx.Module):
    """Eigenvalues of a symmetric map on the product cone; those of a second-order cone belong to (1, u), (1, -u) and
    all that is across."""

    zero: Float[Array, "*zero"]
    orthant: Float[Array, "*orthant"]
    plus: Float[Array, "cones"]
    minus: Float[Array, "cones"]
    across: Float[Array, "cones"]


class Pair(eqx.Module):
    """A slack and a multiplier on the central path, and how they move with the gap."""

    s: ConeVector
    y: ConeVector
    of_slack: Spectrum
    """Eigenvalues of D."""
    of_multiplier: Spectrum
    """Eigenvalues of I - D, without the cancellation."""
    unit: Float[Array, "cones tail"]
    """u: directions of the tails, zero where a tail is."""


def central_pair(gap: ConeVector, mu: Scalar | float) -> Pair:
    """The pair with a given gap; the zero cone's slack is zero."""
    norm = jnp.linalg.norm(gap.second[:, 1:], axis=1)
    unit = gap.second[:, 1:] / jnp.maximum(norm, _TINY)[:, None]
    s, y = _split(gap.orthant, mu)
    s_plus, y_plus = _split(gap.second[:, 0] + norm, mu)
    s_minus, y_minus = _split(gap.second[:, 0] - norm, mu)
    zero, both = jnp.zeros_like(gap.zero), s_plus * s_minus
    return Pair(
        ConeVector(zero, s, _join(s_plus, s_minus, unit)),
        ConeVector(-gap.zero, y, _join(y_plus, y_minus, unit)),
        Spectrum(
            zero,
            s / (s + y),
            s_plus / (s_plus + y_plus),
            s_minus / (s_minus + y_minus),
            both / (both + mu),
        ),
        Spectrum(
            jnp.ones_like(zero),
            y / (s + y),
            y_plus / (s_plus + y_plus),
            y_minus / (s_minus + y_minus),
            mu / (both + mu),
        ),
        unit,
    )


def act(values: Spectrum, unit: Float[Array, "cones tail"], v: ConeVector) -> ConeVector:
    """The symmetric map with these eigenvalues, times v."""
    mean, half = 0.5 * (values.plus + values.minus), 0.5 * (values.plus - values.minus)
    head, tail = v.second[:, 0], v.second[:, 1:]
    along = jnp.sum(unit * tail, axis=1)
    tail = values.across[:, None] * (tail - unit * along[:, None])
    tail += unit * (half * head + mean * along)[:, None]
    # where a tail is zero all three eigenvalues are one, and any direction would serve
    second = jnp.concatenate([(mean * head + half * along)[:, None], tail], axis=1)
    return ConeVector(values.zero * v.zero, values.orthant * v.orthant, second)


def _split(t: Array, mu: Scalar | float) -> tuple[Array, Array]:
    """s and y of a spectral value; the smaller of them from their product, as the difference cancels."""
    large = 0.5 * (jnp.abs(t) + jnp.sqrt(t * t + 4.0 * mu))
    small = mu / large
    return jnp.where(t > 0, large, small), jnp.where(t > 0, small, large)


def _join(
    plus: Float[Array, "cones"], minus: Float[Array, "cones"], unit: Float[Array, "cones tail"]
) -> Array:
    """The point with given spectral values; slack and multiplier share their directions up to the sign."""
    tail = 0.5 * (plus - minus)[:, None] * unit
    return jnp.concatenate([0.5 * (plus + minus)[:, None], tail], axis=1)
