"""The volume that the vehicle's centre may use: the box of the map, unless another one is asked for."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.extent import main_box

Point = Float[np.ndarray, "3"]

_SLACK = 1e-3
"""Distance of a limit from an end that would lie on it, metres."""


class Limits(NamedTuple):
    """A box for the vehicle's centre."""

    lower: Point
    """Lower corner, metres."""
    upper: Point
    """Upper corner, metres."""


def flyable(cloud: PointCloud, start: Point, goal: Point, radius: float, margin: float = 2.0) -> Limits:
    """Box of a map for the vehicle's centre; nobody saw whether space outside it is free.

    It reaches to ``margin`` beyond an end that lies outside the map. It never reaches below the map's lowest point,
    nor nearer to it than the radius, except down to an end that is lower.

    Args:
        cloud: obstacles; stray points do not widen the box. An empty cloud is free space.
        start: (3,) metres.
        goal: (3,) metres.
        radius: safety radius of the vehicle, metres.
        margin: distance beyond an end outside the map, metres.

    Example:
        >>> ground = PointCloud.of([[x, y, 0.0] for x in range(9) for y in range(9)])
        >>> box = flyable(ground, np.array([1.0, 1.0, 2.0]), np.array([7.0, 7.0, 2.0]), radius=0.25)
        >>> box.lower.tolist(), box.upper.tolist()
        ([0.0, 0.0, 0.25], [8.0, 8.0, 4.0])
    """
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    if cloud.count == 0:
        return Limits(low - margin, high + margin)
    box = main_box(cloud.points)
    lower = np.where(low < box.lower, low - margin, box.lower)
    upper = np.where(high > box.upper, high + margin, box.upper)
    lower[2] = min(box.lower[2] + radius, low[2] - _SLACK)
    return Limits(lower, upper)
