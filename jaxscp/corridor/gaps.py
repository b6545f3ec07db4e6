"""Points that close the gaps of surfaces whose points are farther apart than a vehicle is wide."""

import numpy as np
import scipy
from jaxtyping import Float, Int

from jaxscp.corridor.clouds import PointCloud

_PASSABLE = 2.0
"""Distance between rows that a ball passes, in radii."""
_SHORTEST = 1.4
"""Edge of a square that a ball passes, in radii."""
_LONGEST = 10.0
"""Longest gap that is closed, in radii."""
_STRAIGHT = 0.3
"""How far three points may be from equal steps along a line, over the step."""
_PARALLEL = 0.9
_ALIKE = 0.3
_SUPPORT = 3
_NEIGHBOURS = 12
_NEAREST = 64
_CHUNK = 1000
_SAMPLE = 500
_FRACTION = 0.1
"""Fraction of points with passable gaps that makes a map sparse: 0.03 at most in dense ones, 0.15 in lidar scans."""
_PATCH = 9
_FLAT = 0.05
_FLAT_FRACTION = 0.15
_STEP = 0.5
"""Distance between the points that close a gap, in radii."""
_MOST = 5_000_000
_MOST_SPARSE = 100_000

Points = Float[np.ndarray, "_ 3"]
Pairs = Int[np.ndarray, "_ 2"]

_DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], float) - 1.0
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_OPPOSITE = len(_DIRECTIONS) - 1 - np.arange(len(_DIRECTIONS))


def with_closed_gaps(cloud: PointCloud, radius: float) -> tuple[PointCloud, float]:
    """The cloud with points added between rows that are farther apart than a vehicle is wide, and the longest gap.

    Rows repeat: a point whose nearest neighbours in two opposite directions are about equally far, with neighbours of
    the same pattern, lies on a sparse surface. A door does not repeat, so that it stays open.

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
    sample = np.random.default_rng(0).permutation(len(points))[:_SAMPLE]
    passable = _repeating(points, tree, sample, _PASSABLE * radius, _LONGEST * radius)
    if len(np.unique(passable[:, 0])) < _FRACTION * len(sample) or len(points) > _MOST_SPARSE:
        return cloud, 0.0
    if not _on_surfaces(points, tree, sample):
        return cloud, 0.0
    everywhere = np.arange(len(points))
    links = _supported(
        points, tree, _repeating(points, tree, everywhere, _SHORTEST * radius, _LONGEST * radius)
    )
    if not len(links):
        return cloud, 0.0
    added = _filled(points, links, _STEP * radius)
    longest = float(np.linalg.norm(points[links[:, 1]] - points[links[:, 0]], axis=1).max())
    closed = np.concatenate([points, added])
    return PointCloud(closed, cloud.spread, cloud.dropped, cloud.provenance), longest


def _repeating(
    points: Points, tree: scipy.spatial.KDTree, chosen: Int[np.ndarray, "chosen"], least: float, most: float
) -> Pairs:
    """Chosen points with their nearest neighbours in opposite directions, where these are equally far."""
    pairs = [np.empty((0, 2), int)]
    count = min(_NEAREST + 1, len(points))
    for first in range(0, len(chosen), _CHUNK):
        some = chosen[first : first + _CHUNK]
        length, near = tree.query(points[some], k=count)
        off = points[near] - points[some][:, None]
        direction = np.argmax(off @ _DIRECTIONS.T, axis=2)
        along = (direction[:, :, None] == np.arange(len(_DIRECTIONS))) & (length[:, :, None] > 0)
        # Neighbours come in order of distance, so that the first in a direction is the nearest.
        nearest, any_there = np.argmax(along, axis=1), along.any(axis=1)
        rows = np.arange(len(some))[:, None]
        step, offset = length[rows, nearest], off[rows, nearest]
        short, long = np.minimum(step, step[:, _OPPOSITE]), np.maximum(step, step[:, _OPPOSITE])
        bend = np.linalg.norm(offset + offset[:, _OPPOSITE], axis=2)
        repeats = any_there & any_there[:, _OPPOSITE] & (bend <= _STRAIGHT * 0.5 * (short + long))
        row, way = np.nonzero(repeats & (short > least) & (long <= most))
        pairs.append(np.column_stack([some[row], near[row, nearest[row, way]]]))
    return np.concatenate(pairs)


def _on_surfaces(points: Points, tree: scipy.spatial.KDTree, chosen: Int[np.ndarray, "chosen"]) -> bool:
    """Whether enough points lie on surfaces, rather than anywhere in a volume."""
    _, near = tree.query(points[chosen], k=_PATCH)
    off = points[near] - points[near].mean(axis=1, keepdims=True)
    values = np.linalg.eigvalsh(np.einsum("kni,knj->kij", off, off))
    return bool(np.mean(values[:, 0] < _FLAT * values[:, 2]) >= _FLAT_FRACTION)


def _supported(points: Points, tree: scipy.spatial.KDTree, pairs: Pairs) -> Pairs:
    """Pairs of which some neighbours have a parallel one of about the same length."""
    if not len(pairs):
        return pairs
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    step = points[pairs[:, 1]] - points[pairs[:, 0]]
    length = np.linalg.norm(step, axis=1)
    first = np.searchsorted(pairs[:, 0], np.arange(len(points) + 1))
    own = np.unique(pairs[:, 0])
    _, near = tree.query(points[own], k=min(_NEIGHBOURS + 1, len(points)))
    support = np.zeros(len(pairs), int)
    for k, others in zip(own, near, strict=True):
        mine = slice(first[k], first[k + 1])
        for other in others[1:]:
            theirs = slice(first[other], first[other + 1])
            if theirs.start == theirs.stop:
                continue
            cosine = step[mine] @ step[theirs].T / np.outer(length[mine], length[theirs])
            alike = np.abs(np.subtract.outer(length[mine], length[theirs])) <= _ALIKE * length[mine][:, None]
            support[mine] += np.any((cosine > _PARALLEL) & alike, axis=1)
    return pairs[support >= _SUPPORT]


def _filled(points: Points, pairs: Pairs, step: float) -> Points:
    """Points on links, and on the triangles between two links of a point whose ends are as near to each other."""
    length = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1)
    first = np.searchsorted(pairs[:, 0], np.arange(len(points) + 1))
    triangles = [np.column_stack([pairs, pairs[:, 1]])]
    for k in np.unique(pairs[:, 0]):
        ends, reach = pairs[first[k] : first[k + 1], 1], length[first[k] : first[k + 1]]
        between = np.linalg.norm(points[ends][:, None] - points[ends][None], axis=2)
        one, two = np.nonzero(np.triu(between <= 1.01 * np.maximum.outer(reach, reach), 1))
        triangles.append(np.column_stack([np.full(len(one), k), ends[one], ends[two]]))
    corners = points[np.unique(np.sort(np.concatenate(triangles), axis=1), axis=0)]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.ceil(sides / step).astype(int)
    while np.sum(0.5 * (counts + 1.0) * (counts + 2.0)) > _MOST:
        counts = np.maximum(1, counts // 2)
    parts = []
    for count in np.unique(counts):
        i, j = np.nonzero(np.add.outer(np.arange(count + 1), np.arange(count + 1)) <= count)
        weights = np.column_stack([i, j, count - i - j]) / count
        parts.append(np.einsum("wc,tcx->twx", weights, corners[counts == count]).reshape(-1, 3))
    added = np.concatenate(parts)
    # One of many points at a place is enough.
    _, first = np.unique(
        np.floor((added - added.min(axis=0)) / step).astype(np.int64), axis=0, return_index=True
    )
    return added[first]
