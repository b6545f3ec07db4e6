"""Smoothed projection onto a symmetric cone: the central pair (s, y) as a function of t = s - y.

A slack s and a multiplier y with s o y = mu e are determined by their difference t. On the orthant

    s = (t + sqrt(t^2 + 4 mu)) / 2,    y = s - t = mu / s.

On a second-order cone, the same formula holds for the two spectral values of t: t_0 + |t_1| and t_0 - |t_1|. At mu = 0
s is the projection of t onto the cone. Its derivative D = ds/dt is symmetric with eigenvalues between zero and one. The
square of the pair's Nesterov-Todd scaling is W^2 = D (I - D)^-1. On the central path, and only there,
ds = -W^2 dy (Fukushima, Luo and Tseng, "Smoothing functions for second-order-cone complementarity problems", 2002).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.product import ConeVector
from jaxscp.core.types import Scalar

_TINY = 1e-300  # keeps the direction of a zero tail finite


class Spectrum(eqx.Module):
    """Eigenvalues of a symmetric map on the product cone.

    A second-order cone has three: ``plus`` of (1, u), ``minus`` of (1, -u), ``across`` of all vectors orthogonal to
    both, where u is the direction of the tail.
    """

    zero: Float[Array, "*zero"]
    orthant: Float[Array, "*orthant"]
    plus: Float[Array, "cones"]
    minus: Float[Array, "cones"]
    across: Float[Array, "cones"]


class CentralPair(eqx.Module):
    """Slack and multiplier on the central path, with their derivatives with respect to t = s - y."""

    s: ConeVector
    y: ConeVector
    slack_derivative: Spectrum
    """Eigenvalues of D = ds/dt."""
    multiplier_derivative: Spectrum
    """Eigenvalues of I - D = -dy/dt, computed without cancellation."""
    unit: Float[Array, "cones tail"]
    """u: directions of the tails; zero for a zero tail."""


def central_pair(t: ConeVector, mu: Scalar | float) -> CentralPair:
    """Central pair with s - y = t; the zero cone's slack is zero."""
    norm = jnp.linalg.norm(t.second[:, 1:], axis=1)
    unit = t.second[:, 1:] / jnp.maximum(norm, _TINY)[:, None]
    s, y = _split(t.orthant, mu)
    s_plus, y_plus = _split(t.second[:, 0] + norm, mu)
    s_minus, y_minus = _split(t.second[:, 0] - norm, mu)
    zero, both = jnp.zeros_like(t.zero), s_plus * s_minus
    return CentralPair(
        ConeVector(zero, s, _join(s_plus, s_minus, unit)),
        ConeVector(-t.zero, y, _join(y_plus, y_minus, unit)),
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


def apply(values: Spectrum, unit: Float[Array, "cones tail"], v: ConeVector) -> ConeVector:
    """Product of v with the symmetric map of these eigenvalues."""
    mean, half = 0.5 * (values.plus + values.minus), 0.5 * (values.plus - values.minus)
    head, tail = v.second[:, 0], v.second[:, 1:]
    along = jnp.sum(unit * tail, axis=1)
    # With a zero tail the three eigenvalues are equal, so that u = 0 does no harm.
    tail = values.across[:, None] * (tail - unit * along[:, None])
    tail += unit * (half * head + mean * along)[:, None]
    second = jnp.concatenate([(mean * head + half * along)[:, None], tail], axis=1)
    return ConeVector(values.zero * v.zero, values.orthant * v.orthant, second)


def _split(t: Array, mu: Scalar | float) -> tuple[Array, Array]:
    """(s, y) of a spectral value t; the smaller number as mu over the larger, since the difference cancels."""
    large = 0.5 * (jnp.abs(t) + jnp.sqrt(t * t + 4.0 * mu))
    small = mu / large
    return jnp.where(t > 0, large, small), jnp.where(t > 0, small, large)


def _join(
    plus: Float[Array, "cones"], minus: Float[Array, "cones"], unit: Float[Array, "cones tail"]
) -> Array:
    """Point with given spectral values; slack and multiplier have the same u."""
    tail = 0.5 * (plus - minus)[:, None] * unit
    return jnp.concatenate([0.5 * (plus + minus)[:, None], tail], axis=1)
