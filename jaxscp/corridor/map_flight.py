"""A flight, as a map sees it."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscp.corridor.limits import Point


class Flight(eqx.Module):
    """A flight that a map must serve."""

    start: Point
    """Start, (3,), metres."""
    goal: Point
    """Goal, (3,), metres."""
    radius: float
    """Safety radius of the vehicle, metres."""
    lower: Point | None = None
    """Lower corner that the caller stated for the vehicle's centre, metres."""
    upper: Point | None = None
    """Upper corner that the caller stated, metres."""

    @property
    def ends(self) -> Float[np.ndarray, "2 3"]:
        """Start and goal."""
        return np.stack([self.start, self.goal])

    @property
    def length(self) -> float:
        """Straight distance from start to goal, metres."""
        return float(np.linalg.norm(self.goal - self.start))
