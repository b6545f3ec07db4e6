"""The box of a map, stray points left out."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_FEWEST = 40
_FRACTION = 200
_MOST = 1000
_LEAST_GAP = 5.0


class Box(NamedTuple):
    """Box of the points of a map, without stray ones."""

    lower: Float[np.ndarray, "3"]
    """Lower corner, metres."""
    upper: Float[np.ndarray, "3"]
    """Upper corner, metres."""
    strays: int
    """Points outside the box."""


def main_box(points: Float[np.ndarray, "points 3"]) -> Box:
    """Box of all points but a few far ones, along each axis.

    At most one point in 200 is stray. Stray points lie beyond a gap that is wider than 5 m and than all the others
    span along that axis.

    Args:
        points: (points, 3) finite positions, metres; at least one.

    Example:
        >>> points = np.concatenate([np.random.default_rng(0).uniform(0, 8, (500, 3)), [[9000.0, 9000.0, 9000.0]]])
        >>> box = main_box(points)
        >>> box.strays, bool(box.upper.max() < 8)
        (1, True)
    """
    low, high = points.min(axis=0), points.max(axis=0)
    most = min(len(points) // _FRACTION if len(points) >= _FRACTION else len(points) // _FEWEST, _MOST)
    if most < 1:
        return Box(low, high, 0)
    for axis in range(3):
        column = np.partition(points[:, axis], (most, len(points) - 1 - most))
        first, last = np.sort(column[: most + 1]), np.sort(column[len(points) - 1 - most :])
        wide = max(_LEAST_GAP, last[0] - first[-1])
        below = np.flatnonzero(np.diff(first) > wide)
        above = np.flatnonzero(np.diff(last) > wide)
        low[axis] = first[below[-1] + 1] if len(below) else first[0]
        high[axis] = last[above[0]] if len(above) else last[-1]
    strays = 0
    if np.any(low > points.min(axis=0)) or np.any(high < points.max(axis=0)):
        strays = int(np.count_nonzero(~np.all((points >= low) & (points <= high), axis=1)))
    return Box(low, high, strays)
