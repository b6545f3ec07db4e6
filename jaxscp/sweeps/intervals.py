"""What a pass goes through, and what it finds."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import runge_kutta


class Intervals(eqx.Module):
    """What a pass goes through, and how.

    An interval's variables are w = (state, first controls, last controls); controls are linear between.

    Args:
        rate: (state, controls) -> slope of the state by the share of the interval, and of a cost after it; a pytree.
        states: how many.
        method: of integration.
        steps: of an interval.
        every: of how many steps the last one is kept.
    """

    rate: Callable[..., Array]
    states: int = eqx.field(static=True)
    method: runge_kutta.Method = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    every: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.steps % self.every:
            raise ValueError(f"every: {self.steps} steps are no multiple of {self.every}")

    def controls(self, inputs: int) -> int:
        """How many there are at one end, of so many variables."""
        return (inputs - self.states) // 2


class Pass(eqx.Module):
    """What was found, the intervals as leading axis. A path has the cost so far after the state."""

    path: Float[Array, "intervals kept extended"]
    tangent: Float[Array, "intervals kept extended inputs"]
    """The path's Jacobian."""
    curvature: Float[Array, "intervals inputs inputs"] | None
    """Of the slopes at their prices, if these are given."""


def controls_at(
    w: Float[Array, "inputs"], states: int, share: Float[Array, "*b"]
) -> Float[Array, "*b controls"]:
    """Controls at shares of an interval, linear between those at its ends."""
    first, last = jnp.split(w[states:], 2)
    return first + share[..., None] * (last - first)
