"""Actuators: bounds and rates of the controls, a first-order lag, and a delay.

A command c is held over a tick. The active control a follows it with the time constant T after the delay:
a(t + tick) = a + (1 - exp(-tick / T)) (c - a), exact for a first-order lag.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats, namespace
from jaxscp.core.types import Scalar

Control = Float[Array, "controls"]


class Actuators(eqx.Module):
    """How commands become controls.

    Args:
        lower: (controls,) least control; of a rotor, thrust in N. May be -inf.
        upper: (controls,) greatest control. May be inf.
        rate: (controls,) greatest change of a control a second, inf by default.
        time_constant: of the first-order lag in s; zero for none.
        delay: ticks from a command to its first effect.

    Example:
        >>> from jaxscp.control import Actuators
        >>> motors = Actuators([0.0], [5.0], time_constant=0.03, delay=2)
        >>> command = motors.command([2.0], [2.5], 0.01)  # from 2 N to 2.5 N within 10 ms
        >>> f"{command[0]:.3f} N, then {motors.advance([2.0], command, 0.01)[0]:.3f} N"
        '3.764 N, then 2.500 N'
    """

    lower: Control = eqx.field(converter=as_floats)
    upper: Control = eqx.field(converter=as_floats)
    rate: Control | Scalar = eqx.field(default=jnp.inf, converter=as_floats)
    time_constant: Scalar = eqx.field(default=0.0, converter=as_floats)
    delay: int = eqx.field(default=0, static=True)

    def __check_init__(self):
        if jnp.shape(self.lower) != jnp.shape(self.upper):
            raise ValueError(
                f"lower, upper: one number for each control is expected, got shapes {jnp.shape(self.lower)} and "
                f"{jnp.shape(self.upper)}"
            )
        if not isinstance(self.delay, int) or self.delay < 0:
            raise ValueError(f"delay: a whole number of ticks is expected, got {self.delay!r}")
        if namespace(self) is not np:
            return  # numbers that are not known yet
        if not np.all(self.lower <= self.upper):
            raise ValueError(
                f"lower, upper: the least control must not exceed the greatest, got {self.lower} and {self.upper}"
            )
        if not np.all(self.rate > 0.0):
            raise ValueError(f"rate: the greatest change a second must be positive, got {self.rate}")
        if not np.all((self.time_constant >= 0.0) & np.isfinite(self.time_constant)):
            raise ValueError(f"time_constant: seconds, zero or more, are expected, got {self.time_constant}")

    def advance(self, active, command, tick: Scalar | float) -> Control:
        """Controls a tick later, under a command that acts now.

        Args:
            active: (controls,) active controls.
            command: (controls,) held over the tick.
            tick: s.
        """
        active = as_floats(active)
        return active + self._response(tick) * (as_floats(command) - active)

    def command(self, active, target, tick: Scalar | float) -> Control:
        """Command, within the bounds, that takes the active controls to a target in one tick.

        Args:
            active: (controls,) controls when the command begins to act.
            target: (controls,) controls a tick later.
            tick: s.
        """
        active = as_floats(active)
        return jnp.clip(active + (as_floats(target) - active) / self._response(tick), self.lower, self.upper)

    def _response(self, tick: Scalar | float) -> Scalar:
        """Fraction of a step that is reached within a tick; one without a lag."""
        lag = self.time_constant > 0.0
        return jnp.where(lag, -jnp.expm1(-tick / jnp.where(lag, self.time_constant, 1.0)), 1.0)
