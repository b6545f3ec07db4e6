"""Dryden gusts at low altitude: shaping filters driven by white noise."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar, Vector3

GustState = Float[Array, "5"]
"""One lag along the wind, two across it, two upwards; each of unit variance or one of its lags."""

_FOOT = 0.3048
_LAGS = ((1.0, 0.5), (0.5, 0.5))
"""Stationary covariance of two equal lags in series, the first of unit variance (Lyapunov equation)."""
_ROOT3 = 3.0**0.5


class Dryden(eqx.Module):
    """Turbulence of a mean wind (MIL-F-8785C, section 3.7; MIL-HDBK-1797A, appendix A; low altitude).

    The filters are discretised exactly, so that variance does not depend on the step. The frozen field passes at the
    mean wind's speed: a vehicle that hovers meets this spectrum.

    Example:
        >>> import jax
        >>> gusts = Dryden(wind=[6.0, 0.0, 0.0])
        >>> state = gusts.init(jax.random.key(0))
        >>> state, gust = gusts.step(state, 0.005, jax.random.key(1))
        >>> gust.shape
        (3,)
    """

    wind: Vector3 = eqx.field(converter=as_floats)
    """Mean wind at 6 m, m/s, world axes; horizontal."""
    altitude: Scalar = eqx.field(converter=as_floats, default=6.0)
    """Height over ground that sets scales and variances, m; 3 m at least are used."""

    def speed(self) -> Scalar:
        """Speed in m/s at which the field passes; 0.5 at least, so that calm air divides by no zero."""
        return jnp.sqrt(self.wind @ self.wind + 0.25)

    def lengths(self) -> Vector3:
        """L_u, L_v, L_w in m."""
        feet = jnp.maximum(self.altitude, 3.0) / _FOOT
        horizontal = feet / (0.177 + 0.000823 * feet) ** 1.2
        return jnp.stack([horizontal, horizontal, feet]) * _FOOT

    def deviations(self) -> Vector3:
        """Standard deviations along, across and above the wind, m/s: sigma_w = 0.1 W20."""
        feet = jnp.maximum(self.altitude, 3.0) / _FOOT
        vertical = 0.1 * jnp.sqrt(self.wind @ self.wind + 1e-12)
        horizontal = vertical / (0.177 + 0.000823 * feet) ** 0.4
        return jnp.stack([horizontal, horizontal, vertical])

    def spectrum(self, frequency: Float[Array, "frequencies"]) -> Float[Array, "3 frequencies"]:
        """One-sided spectral densities in (m/s)^2/Hz at frequencies in Hz."""
        delay = (self.lengths() / self.speed())[:, None]
        scaled = (2.0 * jnp.pi * frequency * delay) ** 2
        longitudinal = 4.0 * delay[:1] / (1.0 + scaled[:1])
        transverse = 2.0 * delay[1:] * (1.0 + 3.0 * scaled[1:]) / (1.0 + scaled[1:]) ** 2
        return self.deviations()[:, None] ** 2 * jnp.concatenate([longitudinal, transverse])

    def init(self, key: PRNGKeyArray) -> GustState:
        """A stationary state."""
        noise = jax.random.normal(key, (5,))
        factor = jnp.linalg.cholesky(jnp.array(_LAGS))
        return jnp.concatenate([noise[:1], factor @ noise[1:3], factor @ noise[3:]])

    def step(self, state: GustState, dt: float, key: PRNGKeyArray) -> tuple[GustState, Vector3]:
        """State and gust in m/s, world axes, after dt seconds."""
        noise = jax.random.normal(key, (5,))
        rate = dt * self.speed() / self.lengths()
        along = _one_lag(state[0], rate[0], noise[0])
        across, above = (_two_lags(state[i : i + 2], rate[j], noise[i : i + 2]) for i, j in ((1, 1), (3, 2)))
        new = jnp.concatenate([along[None], across, above])
        outputs = [
            along,
            *((_ROOT3 * lag[0] + (1.0 - _ROOT3) * lag[1]) / 2.0**0.5 for lag in (across, above)),
        ]
        return new, self._axes() @ (self.deviations() * jnp.stack(outputs))

    def _axes(self) -> Float[Array, "3 3"]:
        """Columns: along the wind, across it, up."""
        angle = jnp.arctan2(self.wind[1], self.wind[0])
        c, s = jnp.cos(angle), jnp.sin(angle)
        return jnp.stack(
            [jnp.stack([c, -s, 0.0 * c]), jnp.stack([s, c, 0.0 * c]), jnp.array([0.0, 0.0, 1.0])]
        )


def _one_lag(state: Scalar, rate: Scalar, noise: Scalar) -> Scalar:
    """An Ornstein-Uhlenbeck process of unit variance after ``rate`` time constants."""
    return jnp.exp(-rate) * state + jnp.sqrt(-jnp.expm1(-2.0 * rate)) * noise


def _two_lags(state: Float[Array, "2"], rate: Scalar, noise: Float[Array, "2"]) -> Float[Array, "2"]:
    """Two equal lags in series after ``rate`` time constants."""
    decay, one = jnp.exp(-rate), jnp.ones_like(rate)
    step = decay * jnp.stack([jnp.stack([one, 0.0 * rate]), jnp.stack([rate, one])])
    covariance = jnp.array(_LAGS)
    added = covariance - step @ covariance @ step.T
    return step @ state + jnp.linalg.cholesky(added + 1e-15 * jnp.eye(2)) @ noise
