"""The carrier's course: at rest, then a straight line at constant speed and yaw rate, then at rest again."""

import equinox as eqx
import jax.numpy as jnp

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar, Vector3

_ALWAYS = 1e4
_RAMP = 1.5


class Course(eqx.Module):
    """Reference of the carrier over time. Speed changes by ramps of 1.5 s.

    Example:
        >>> import jax.numpy as jnp
        >>> course = Course(velocity=[1.0, 0.0, 0.0], departure=2.0, duration=5.0)
        >>> position, velocity, yaw = course.at(jnp.array(5.0))
        >>> position.tolist(), velocity.tolist()
        ([2.25, 0.0, 0.0], [1.0, 0.0, 0.0])
    """

    start: Vector3 = eqx.field(converter=as_floats, default=(0.0, 0.0, 0.0))
    """Position at time zero, m."""
    velocity: Vector3 = eqx.field(converter=as_floats, default=(0.0, 0.0, 0.0))
    """m/s."""
    yaw_rate: Scalar = eqx.field(converter=as_floats, default=0.0)
    """rad/s."""
    departure: Scalar = eqx.field(converter=as_floats, default=-_ALWAYS)
    """s; long ago by default: in motion from the first moment."""
    duration: Scalar = eqx.field(converter=as_floats, default=2.0 * _ALWAYS)
    """s from departure to the ramp that ends the motion."""

    def at(self, time: Scalar) -> tuple[Vector3, Vector3, Scalar]:
        """Position in m, velocity in m/s, and yaw in rad at a time in s."""
        way = self._way(time) - self._way(jnp.zeros_like(time))
        return self.start + self.velocity * way, self.velocity * self._rate(time), self.yaw_rate * way

    def _way(self, time: Scalar) -> Scalar:
        """Seconds at full speed that give the distance."""
        return _integral(time - self.departure) - _integral(time - self.departure - self.duration)

    def _rate(self, time: Scalar) -> Scalar:
        rise, fall = ((time - t) / _RAMP for t in (self.departure, self.departure + self.duration))
        return jnp.clip(rise, 0.0, 1.0) - jnp.clip(fall, 0.0, 1.0)


def _integral(elapsed: Scalar) -> Scalar:
    """Integral of a ramp from zero to one."""
    inside = jnp.clip(elapsed, 0.0, _RAMP)
    return 0.5 * inside**2 / _RAMP + jnp.maximum(elapsed - _RAMP, 0.0)
