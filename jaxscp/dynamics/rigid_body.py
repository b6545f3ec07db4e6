"""A rigid body under rotor thrusts."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics import rotations
from jaxscp.dynamics.base import Dynamics
from jaxscp.linalg.eigen.pseudo_inverse import pseudo_inverse


class RigidBody(Dynamics):
    """A rigid body under rotor thrusts (equations 1-6), for any number and any tilt of rotors.

    State (13): position m, velocity m/s (both in the world, z up), attitude quaternion (w, x, y, z; body to
    world), body rate rad/s. Control (m): rotor thrusts in N.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> body = jaxscp.airframes.paper_mav().body
        >>> level = jnp.zeros(13).at[6].set(1.0)
        >>> rate = body(level, body.hover_thrust())
        >>> bool(jnp.abs(rate).max() < 1e-6)
        True
    """

    mass: Scalar = eqx.field(converter=as_floats)
    """kg"""
    inertia: Float[Array, "3 3"] = eqx.field(converter=as_floats)
    """kg m^2, about the centre of mass in body axes."""
    thrust_map: Float[Array, "3 rotors"] = eqx.field(converter=as_floats)
    """M_T: force in body axes of one newton of each rotor's thrust."""
    torque_map: Float[Array, "3 rotors"] = eqx.field(converter=as_floats)
    """M_sigma: torque in body axes of one newton of each rotor's thrust, in metres."""
    gravity: Vector3 = eqx.field(converter=as_floats)
    """m/s^2 in world axes, usually (0, 0, -9.81)."""

    @property
    def state_size(self) -> int:
        """13."""
        return 13

    @property
    def control_size(self) -> int:
        """Number of rotors."""
        return self.thrust_map.shape[-1]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Position, velocity, attitude, body rate."""
        position = tuple(f"{axis} [m]" for axis in "xyz")
        velocity = tuple(f"v{axis} [m/s]" for axis in "xyz")
        attitude = tuple(f"q{part}" for part in "wxyz")
        return (*position, *velocity, *attitude, *(f"w{axis} [rad/s]" for axis in "xyz"))

    @property
    def control_names(self) -> tuple[str, ...]:
        """Thrusts."""
        return tuple(f"thrust {rotor + 1} [N]" for rotor in range(self.control_size))

    @property
    def rate_names(self) -> tuple[str, ...]:
        """Accelerations alone: the other derivatives follow from the state."""
        acceleration = tuple(f"a{axis} [m/s^2]" for axis in "xyz")
        return (*[""] * 3, *acceleration, *[""] * 4, *(f"dw{axis}/dt [rad/s^2]" for axis in "xyz"))

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float = 0.0
    ) -> Float[Array, "states"]:
        """Equations (1)-(4)."""
        velocity, attitude, body_rate = state[3:6], state[6:10], state[10:13]
        acceleration = (
            rotations.rotation_matrix(attitude) @ (self.thrust_map @ control) / self.mass + self.gravity
        )
        torque = self.torque_map @ control - jnp.cross(body_rate, self.inertia @ body_rate)
        return jnp.concatenate(
            [
                velocity,
                acceleration,
                rotations.quaternion_rate(attitude, body_rate),
                _inverse(self.inertia) @ torque,
            ]
        )

    def hover_thrust(self) -> Float[Array, "rotors"]:
        """Least-norm rotor thrusts in N that carry the level body's weight without torque."""
        weight = jnp.concatenate([-self.mass * self.gravity, jnp.zeros_like(self.gravity)])
        return self.least_thrusts() @ weight

    def least_thrusts(self) -> Float[Array, "rotors 6"]:
        """Least-norm rotor thrusts of each unit of force in N and of torque in N m, in body axes."""
        return pseudo_inverse(jnp.concatenate([self.thrust_map, self.torque_map]))


def _inverse(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """By cross products: a factorisation is a dozen launches of a GPU, for each slope of a flight that is flown."""
    a, b, c = matrix.T
    rows = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    return rows / (rows[0] @ a)
