"""How far the points of a map are from each other, and points that close the gaps of a sparse surface."""

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from jaxscp.corridor.clouds import PointCloud

_SAMPLE = 50_000
_QUERIES = 2000
_NEIGHBOURS = 8
_REACH = 1.25
"""Length of a gap over the distance to the eighth neighbour: 1.41 in a square grid, which leaves its double open."""
_FLAT = 0.01
_ROUND = 0.05
_LONGEST = 20.0
"""Longest gap that is closed, in radii."""
_STEP = 0.5
"""Distance between the points that close a gap, in radii."""
_MOST = 5_000_000

Points = Float[np.ndarray, "points 3"]
Sparse = Int[np.ndarray, "sparse"]


def typical_spacing(points: Points) -> float:
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


def with_closed_gaps(cloud: PointCloud, radius: float) -> tuple[PointCloud, float]:
    """The cloud with points added where a vehicle would pass between neighbours on a surface, and the longest gap.

    A point is sparse if a ball of the radius passes between it and its eight nearest neighbours, and these lie in a
    plane. Triangles of such points and their neighbours in that plane are filled. A gap of twice the distance between
    neighbours stays open: that is a door.

    Args:
        cloud: obstacles.
        radius: radius of the vehicle, metres.

    Returns:
        The cloud, and the longest gap that was closed, metres; zero where none was.

    Example:
        >>> wall = PointCloud.of([[0.0, y, z] for y in np.arange(0, 7, 0.7) for z in np.arange(0, 7, 0.7)])
        >>> closed, longest = with_closed_gaps(wall, 0.25)
        >>> closed.count > 10 * wall.count, round(longest, 2)
        (True, 0.99)
    """
    points = cloud.points
    if len(points) <= _NEIGHBOURS or not radius > 0:
        return cloud, 0.0
    tree = scipy.spatial.KDTree(points)
    distances, neighbours = tree.query(points, k=_NEIGHBOURS + 1)
    eighth = distances[:, -1]
    sparse = np.flatnonzero((eighth > 2.0 * radius) & (eighth < _LONGEST * radius))
    if not len(sparse):
        return cloud, 0.0
    flat, normals = _planes(points[neighbours[sparse]])
    sparse, normals = sparse[flat], normals[flat]
    # At the rim of a surface the eighth neighbour is farther than inside, so its neighbours decide.
    reach = _REACH * np.quantile(eighth[neighbours[sparse]], 0.25, axis=1)
    triangles = _triangles(points, tree, sparse, normals, reach)
    if not len(triangles):
        return cloud, 0.0
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    added = _filled(corners, sides.max(axis=1), _STEP * radius)
    points = np.concatenate([points, added])
    return PointCloud(points, cloud.spread, cloud.dropped, cloud.provenance), float(sides.max())


def _planes(
    groups: Float[np.ndarray, "sparse 9 3"],
) -> tuple[Bool[np.ndarray, "sparse"], Float[np.ndarray, "sparse 3"]]:
    """Whether each group of points lies in a plane but not on a line, and the normal of that plane."""
    off = groups - groups.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("gpi,gpj->gij", off, off))
    flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > _ROUND * values[:, 2])
    return flat, vectors[:, :, 0]


def _triangles(
    points: Points, tree: scipy.spatial.KDTree, sparse: Sparse, normals: np.ndarray, reach: np.ndarray
) -> Int[np.ndarray, "triangles 3"]:
    """Triangles of each sparse point with two neighbours in its plane that are as near to each other."""
    found: list[np.ndarray] = []
    for first in range(0, len(sparse), 1000):
        some = slice(first, first + 1000)
        around = tree.query_ball_point(points[sparse[some]], reach[some])
        for centre, normal, limit, near in zip(sparse[some], normals[some], reach[some], around, strict=True):
            others = np.array([k for k in near if k != centre], int)
            off = points[others] - points[centre]
            others = others[np.abs(off @ normal) <= 0.25 * np.linalg.norm(off, axis=1)]
            between = np.linalg.norm(points[others][:, None] - points[others][None], axis=2)
            one, two = np.nonzero(np.triu(between <= limit, 1))
            found.append(np.column_stack([np.full(len(one), centre), others[one], others[two]]))
    triangles = np.concatenate(found) if found else np.empty((0, 3), int)
    return np.unique(np.sort(triangles, axis=1), axis=0)


def _filled(
    corners: Float[np.ndarray, "triangles 3 3"], longest: Float[np.ndarray, "triangles"], step: float
) -> Points:
    """Points on triangles, no farther than the step from each other; fewer where there would be too many."""
    counts = np.ceil(longest / step).astype(int)
    while np.sum(0.5 * (counts + 1.0) * (counts + 2.0)) > _MOST:
        counts = np.maximum(1, counts // 2)
    parts = []
    for count in np.unique(counts):
        i, j = np.nonzero(np.add.outer(np.arange(count + 1), np.arange(count + 1)) <= count)
        weights = np.column_stack([i, j, count - i - j]) / count
        parts.append(np.einsum("wc,tcx->twx", weights, corners[counts == count]).reshape(-1, 3))
    return np.concatenate(parts)
