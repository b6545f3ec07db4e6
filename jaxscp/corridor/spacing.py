"""How far the points of a map are from each other."""

import numpy as np
import scipy
from jaxtyping import Float

_SAMPLE = 50_000
_QUERIES = 2000


def typical_spacing(points: Float[np.ndarray, "points 3"]) -> float:
    """Median distance in metres from a point to its nearest neighbour that is not a copy; inf for one point.

    Of a large cloud, the points of a thin slice stand for all.

    Args:
        points: (points, 3) positions, metres.

    Example:
        >>> typical_spacing(np.array([[x, y, 0.0] for x in range(9) for y in range(9)]))
        1.0
    """
    if len(points) > _SAMPLE:
        axis = int(np.argmax(np.ptp(points[:: len(points) // _QUERIES], axis=0)))
        column = points[:, axis]
        centre = column[len(points) // 2]
        sample = np.abs(column[:: max(1, len(points) // _SAMPLE)] - centre)
        half = np.quantile(sample, min(1.0, _SAMPLE / len(points)))
        points = points[np.abs(column - centre) <= half]
    distinct = np.unique(points, axis=0)
    if len(distinct) < 2:
        return float("inf")
    chosen = distinct[:: max(1, len(distinct) // _QUERIES)]
    return float(np.median(scipy.spatial.KDTree(distinct).query(chosen, k=2)[0][:, 1]))
