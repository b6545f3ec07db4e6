"""Rotor thrusts from commands: delay, saturation, lag, and the battery's sag."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar


class MotorState(eqx.Module):
    """Thrusts, commands on their way, and charge."""

    thrusts: Float[Array, "rotors"]
    """N."""
    waiting: Float[Array, "delay rotors"]
    """Commands in N, the oldest first."""
    used: Scalar
    """Fraction of the battery's charge that is used."""


class Motors(eqx.Module):
    """First-order motors with a delay of whole steps, saturation, and a battery.

    Full voltage gives ``thrust_max``. Thrust at full throttle grows with the square of voltage. Current grows with
    the power of the rotors, T^(3/2) each (momentum theory).

    Example:
        >>> motors = Motors(thrust_min=[0.1] * 4, thrust_max=[6.25] * 4)
        >>> motors.init().waiting.shape
        (4, 4)
    """

    thrust_min: Float[Array, "rotors"] = eqx.field(converter=as_floats)
    """N."""
    thrust_max: Float[Array, "rotors"] = eqx.field(converter=as_floats)
    """N, each rotor, full battery without load."""
    time_constant: Scalar = eqx.field(converter=as_floats, default=0.03)
    """s."""
    endurance: Scalar = eqx.field(converter=as_floats, default=600.0)
    """Time in s to empty the battery at 40 % of all thrust."""
    empty_voltage: Scalar = eqx.field(converter=as_floats, default=0.83)
    """Voltage of the empty battery as a fraction of the full one's."""
    load_sag: Scalar = eqx.field(converter=as_floats, default=0.08)
    """Fraction of the full voltage lost in the battery's resistance at full power."""
    delay: int = eqx.field(static=True, default=4)
    """Steps between command and motor."""

    def init(self) -> MotorState:
        """Motors at their least thrust, battery full."""
        waiting = jnp.broadcast_to(self.thrust_min, (self.delay, *self.thrust_min.shape))
        return MotorState(self.thrust_min, waiting, jnp.zeros(()))

    def power(self, thrusts: Float[Array, "rotors"]) -> Scalar:
        """Power as a fraction of that at full thrust."""
        return jnp.mean((jnp.maximum(thrusts, 0.0) / self.thrust_max) ** 1.5)

    def greatest(self, state: MotorState) -> Float[Array, "rotors"]:
        """Thrust in N of each rotor at full throttle, at the present charge and load."""
        voltage = 1.0 - (1.0 - self.empty_voltage) * jnp.minimum(state.used, 1.0)
        return self.thrust_max * (voltage - self.load_sag * self.power(state.thrusts)) ** 2

    def step(self, state: MotorState, command: Float[Array, "rotors"], dt: float) -> MotorState:
        """The state after dt seconds of a constant command in N; the lag is integrated exactly."""
        line = jnp.concatenate([state.waiting, command[None]])
        target = jnp.clip(line[0], self.thrust_min, self.greatest(state))
        thrusts = target + jnp.exp(-dt / self.time_constant) * (state.thrusts - target)
        used = state.used + dt / self.endurance * self.power(thrusts) / 0.4**1.5
        return MotorState(thrusts, line[1:], used)
