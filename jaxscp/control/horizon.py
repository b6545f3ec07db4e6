"""The grid of a prediction."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats, floats, namespace
from jaxscp.core.types import Scalar


def growing(duration: float, count: int, ratio: float = 1.2) -> Float[Array, "intervals"]:
    """Lengths of intervals that grow by a ratio: fine where the controls act next.

    Example:
        >>> from jaxscp.control import growing
        >>> growing(1.0, 4, 2.0).round(3).tolist()
        [0.067, 0.133, 0.267, 0.533]
    """
    lengths = ratio ** np.arange(count)
    return floats(duration * lengths / np.sum(lengths))


class Horizon(eqx.Module):
    """The prediction's grid, and the work of a tick.

    Args:
        intervals: (intervals,) lengths in s; a second in ten intervals that grow, by default.
        tick: s between two calls of the controller.
        steps: Runge-Kutta steps of an interval.
        iterations: most interior-point steps of a tick: they bound its time.
        tolerance: relative, of the convex program; where it is missed, the status says so. For derivatives that agree
            with differences choose 1e-10, and more iterations.
    """

    intervals: Float[Array, "intervals"] = eqx.field(
        default_factory=lambda: growing(1.0, 10), converter=as_floats
    )
    tick: Scalar = eqx.field(default=0.01, converter=as_floats)
    steps: int = eqx.field(default=2, static=True)
    iterations: int = eqx.field(default=7, static=True)
    tolerance: float = eqx.field(default=1e-4, static=True)

    def __check_init__(self):
        if self.iterations < 1 or self.steps < 1:
            raise ValueError(
                f"iterations, steps: one or more are needed, got {self.iterations} and {self.steps}"
            )
        if not self.tolerance > 0.0:
            raise ValueError(f"tolerance: must be positive, got {self.tolerance}")
        if namespace(self) is not np:
            return  # numbers that are not known yet
        if not np.all((self.tick > 0.0) & np.isfinite(self.tick)):
            raise ValueError(
                f"tick: seconds between two calls, more than zero, are expected, got {self.tick}"
            )
        if not (self.intervals.size and np.all((self.intervals > 0.0) & np.isfinite(self.intervals))):
            raise ValueError(
                f"intervals: one length or more is expected, each positive, in s, got {self.intervals}"
            )

    @property
    def grid(self) -> Float[Array, "nodes"]:
        """Times of the nodes, s from the first."""
        return jnp.concatenate([jnp.zeros_like(self.intervals[:1]), jnp.cumsum(self.intervals)])
