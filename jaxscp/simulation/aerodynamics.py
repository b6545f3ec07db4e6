"""Aerodynamic force and torque on the vehicle, beside its rotors' nominal thrust."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Quaternion, Scalar, Vector3
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.simulation.vehicles import FEET_DEPTH

_NEAREST = 0.5
"""Least height in rotor radii that the formula of ground effect is used at: it has a pole at a quarter."""


class Deck(eqx.Module):
    """The carrier's deck, and the flow that its rotors cause."""

    position: Vector3
    """Centre of the deck's surface, m, world axes."""
    attitude: Quaternion
    """Carrier's attitude, (w, x, y, z), body to world."""
    thrust: Scalar
    """Total thrust of the carrier's rotors, N."""


class Aerodynamics(eqx.Module):
    """Parameters of the aerodynamic wrench. Each number may vary over a batch.

    Example:
        >>> import jax.numpy as jnp
        >>> level = jnp.zeros(13).at[6].set(1.0).at[2].set(5.0)
        >>> far = Deck(jnp.array([50.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array(128.0))
        >>> force, torque = Aerodynamics().wrench(level, jnp.full(4, 2.3), jnp.array([4.0, 0.0, 0.0]), far)
        >>> bool(force[0] > 0.0), bool(jnp.abs(force[1]) < 1e-9)
        (True, True)
    """

    rotor_drag: Vector3 = eqx.field(converter=as_floats, default=(0.045, 0.045, 0.02))
    """Drag of one rotor per air speed and root of thrust, N^(1/2) s/m, body axes (induced drag: Faessler, Franchi,
    Scaramuzza, "Differential Flatness of Quadrotor Dynamics Subject to Rotor Drag", RA-L 2018, made proportional to
    rotor speed). Four rotors at hover: 0.27 N s/m."""
    drag_area: Scalar = eqx.field(converter=as_floats, default=0.01)
    """Drag coefficient times frontal area, m^2."""
    rotor_height: Scalar = eqx.field(converter=as_floats, default=0.02)
    """Height of the rotor plane over the centre of mass, m."""
    rotor_radius: Scalar = eqx.field(converter=as_floats, default=0.038)
    """m."""
    feet_height: Scalar = eqx.field(converter=as_floats, default=FEET_DEPTH)
    """Depth of the feet's lowest points under the centre of mass, m."""
    suction: Scalar = eqx.field(converter=as_floats, default=2.2)
    """F0: suction of the deck on a vehicle that stands on it, N."""
    suction_height: Scalar = eqx.field(converter=as_floats, default=0.25)
    """h0: height in m over which suction falls by e."""
    deck_radius: Scalar = eqx.field(converter=as_floats, default=0.4)
    """Half width of the region of suction and deck effect, m."""
    carrier_radius: Scalar = eqx.field(converter=as_floats, default=0.6)
    """Radius of the actuator disk that stands for the carrier's rotors, m."""
    air_density: Scalar = eqx.field(converter=as_floats, default=1.2)
    """kg/m^3."""

    def wrench(
        self,
        state: Float[Array, "13"],
        thrusts: Float[Array, "rotors"],
        wind: Vector3,
        deck: Deck,
    ) -> tuple[Vector3, Vector3]:
        """Force in world axes, N, and torque about the centre of mass in body axes, N m.

        Args:
            state: position m, velocity m/s, attitude (w, x, y, z), body rate rad/s.
            thrusts: thrust of each rotor, N.
            wind: velocity of the air far from the carrier, m/s, world axes.
            deck: the carrier's deck.
        """
        turn = rotation_matrix(state[6:10])
        height, offset = self._over(deck, state[:3])
        near = _falloff(offset, self.deck_radius)
        air = wind + self.inflow(deck, state[:3]) - state[3:6]
        drag = self.drag(turn.T @ air, thrusts)
        gain = self.ground_effect(state[2]) + near * self.ground_effect(height)
        lift = gain * jnp.sum(thrusts) * turn[:, 2]
        pull = (
            self.suction * jnp.exp(-jnp.maximum(height - self.feet_height, 0.0) / self.suction_height) * near
        )
        above = jnp.where(height > 0.0, 1.0, 0.0)
        normal = rotation_matrix(deck.attitude)[:, 2]
        arm = self.rotor_height * jnp.array([0.0, 0.0, 1.0])
        return turn @ drag + lift - above * pull * normal, jnp.cross(arm, drag)

    def drag(self, air: Vector3, thrusts: Float[Array, "rotors"]) -> Vector3:
        """Rotor drag and body drag in N at a velocity of the air relative to the vehicle, both in body axes."""
        speed = jnp.sqrt(air @ air + 1e-12)  # smooth at rest
        rotors = self.rotor_drag * jnp.sum(jnp.sqrt(jnp.maximum(thrusts, 0.0) + 1e-12))
        return (rotors + 0.5 * self.air_density * self.drag_area * speed) * air

    def inflow(self, deck: Deck, position: Vector3) -> Vector3:
        """Velocity in m/s that the carrier's actuator disk induces: v_i (1 - z / sqrt(R^2 + z^2)) along its axis.

        Momentum theory gives v_i = sqrt(T / (2 rho A)); the vortex tube gives its decay above the disk and its growth
        to 2 v_i below (Leishman, "Principles of Helicopter Aerodynamics", chapter 2). Off the axis it falls as a
        smooth step.
        """
        area = jnp.pi * self.carrier_radius**2
        induced = jnp.sqrt(jnp.maximum(deck.thrust, 0.0) / (2.0 * self.air_density * area) + 1e-12)
        height, offset = self._over(deck, position)
        share = 1.0 - height / jnp.sqrt(self.carrier_radius**2 + height**2)
        return -induced * share * _falloff(offset, self.carrier_radius) * rotation_matrix(deck.attitude)[:, 2]

    def ground_effect(self, height: Scalar) -> Scalar:
        """Gain of thrust, as a fraction, at a height in m over a surface; zero below the surface.

        1 / (1 - (R / 4z)^2) - 1 (Cheeseman and Bennett, ARC R&M 3021, 1955), z of the rotor plane.
        """
        z = jnp.maximum(height + self.rotor_height, _NEAREST * self.rotor_radius)
        gain = 1.0 / (1.0 - (self.rotor_radius / (4.0 * z)) ** 2) - 1.0
        return jnp.where(height > 0.0, gain, 0.0)

    def _over(self, deck: Deck, position: Vector3) -> tuple[Scalar, Scalar]:
        """Height over the deck along its normal, and distance from its axis, m."""
        local = rotation_matrix(deck.attitude).T @ (position - deck.position)
        return local[2], jnp.sqrt(local[:2] @ local[:2] + 1e-12)


def _falloff(offset: Scalar, radius: Scalar) -> Scalar:
    """One on the axis, a half at the radius, zero far away."""
    return 1.0 / (1.0 + (offset / radius) ** 8)
