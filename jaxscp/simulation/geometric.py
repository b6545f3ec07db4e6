"""A geometric controller: position by PID, attitude on SO(3)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.airframes import Airframe
from jaxscp.dynamics.rotations import rotation_matrix


class Geometric(eqx.Module):
    """Rotor thrusts that track a reference, with an integral of the position error.

    Source: Lee, Leok, McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> pilot = Geometric(jaxscp.airframes.paper_mav())
        >>> level = jnp.zeros(13).at[6].set(1.0)
        >>> _, thrusts = pilot(jnp.zeros(3), level, jnp.zeros(3), jnp.zeros(3), 0.01)
        >>> bool(jnp.allclose(thrusts.sum(), 0.928 * 9.81))
        True
    """

    airframe: Airframe
    position_gain: Scalar = eqx.field(converter=as_floats, default=6.0)
    """1/s^2."""
    velocity_gain: Scalar = eqx.field(converter=as_floats, default=4.5)
    """1/s."""
    integral_gain: Scalar = eqx.field(converter=as_floats, default=3.0)
    """1/s^3."""
    attitude_gain: Scalar = eqx.field(converter=as_floats, default=150.0)
    """1/s^2."""
    rate_gain: Scalar = eqx.field(converter=as_floats, default=22.0)
    """1/s."""
    yaw: Scalar = eqx.field(converter=as_floats, default=0.0)
    """Heading to hold, rad."""

    def __call__(
        self,
        integral: Vector3,
        state: Float[Array, "13"],
        position: Vector3,
        velocity: Vector3,
        dt: float,
    ) -> tuple[Vector3, Float[Array, "rotors"]]:
        """Integral of the position error in m s, and thrusts in N, at a reference in m and m/s."""
        error = position - state[:3]
        integral = jnp.clip(integral + error * dt, -1.0, 1.0)
        body, turn = self.airframe.body, rotation_matrix(state[6:10])
        acceleration = (
            self.position_gain * error
            + self.velocity_gain * (velocity - state[3:6])
            + self.integral_gain * integral
            - body.gravity
        )
        goal = self._attitude(acceleration)
        skew = goal.T @ turn - turn.T @ goal
        angle = 0.5 * jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
        rate = state[10:13]
        torque = body.inertia @ (-self.attitude_gain * angle - self.rate_gain * rate)
        torque = torque + jnp.cross(rate, body.inertia @ rate)
        force = jnp.zeros(3).at[2].set(body.mass * acceleration @ turn[:, 2])
        thrusts = body.least_thrusts() @ jnp.concatenate([force, torque])
        return integral, jnp.clip(thrusts, self.airframe.thrust_min, self.airframe.thrust_max)

    def _attitude(self, acceleration: Vector3) -> Float[Array, "3 3"]:
        """The attitude with its z axis along the thrust, and the heading."""
        up = acceleration / jnp.linalg.norm(acceleration)
        heading = jnp.stack([jnp.cos(self.yaw), jnp.sin(self.yaw), 0.0 * self.yaw])
        left = jnp.cross(up, heading)
        left = left / jnp.linalg.norm(left)
        return jnp.stack([jnp.cross(left, up), left, up], axis=1)
