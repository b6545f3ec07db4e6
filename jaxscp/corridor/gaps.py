"""Points that close the holes of surfaces whose points are farther apart than a vehicle is wide."""

import warnings

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from jaxscp.corridor.clouds import PointCloud

_LONGEST = 10.0
"""Radius of the largest hole that is closed, in radii of the vehicle."""
_GROWTH = 1.15
"""Ratio of the radii of discs that holes are measured by."""
_MARGIN = 1.1
_TYPICAL = 0.9
"""Quantile of the holes of surfaces that the radius of closed holes follows from."""
_DIRECTIONS = 16
_NEAREST = 64
_PATCHES = (9, 32)
"""Neighbours that a tangent plane is fitted to; the second number serves rows of dense points."""
_PLANAR = 0.05
_ROW = 0.05
_SLAB = 0.3
"""Distance of neighbours of the same surface from the tangent plane, over their distance from the point."""
_SAMPLE = 500
_FRACTION = 0.1
"""Fraction of points beside holes that makes a map sparse."""
_FLAT = 0.05
_FLAT_FRACTION = 0.15
_STEP = 0.5
"""Distance between the points that close a hole, in radii."""
_MOST = 3_000_000
_MOST_SPARSE = 100_000

Points = Float[np.ndarray, "_ 3"]
Triangles = Int[np.ndarray, "_ 3"]


def with_closed_gaps(cloud: PointCloud, radius: float) -> tuple[PointCloud, float]:
    """The cloud with points added in holes of sparse surfaces, and the longest gap between neighbours that these close.

    The largest empty discs in tangent planes measure the holes. A map is sparse where many of its points lie beside
    holes that the vehicle passes. Then holes up to their typical radius are closed. Every triangle of the Delaunay
    tessellation with at most that circumradius is filled (after the alpha shapes of Edelsbrunner and Muecke, 1994).
    A door wider than twice that radius stays open.

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
    if len(points) <= _PATCHES[0] or not radius > 0:
        return cloud, 0.0
    alpha = _typical_hole(points, radius)
    if alpha <= radius:
        return cloud, 0.0
    if len(points) > _MOST_SPARSE:
        warnings.warn(
            f"neighbouring points leave holes of {2.0 * alpha:.2g} m, which a vehicle of radius {radius:g} m passes. "
            f"They stay open, for the map has {len(points)} points, more than {_MOST_SPARSE}: cut it to the flight",
            stacklevel=2,
        )
        return cloud, 0.0
    corners = _triangles(points, alpha, radius)
    if not len(corners):
        return cloud, 0.0
    added = _filled(corners, _STEP * radius)
    longest = float(_sides(corners).max())
    closed = np.concatenate([points, added])
    return PointCloud(closed, cloud.spread, cloud.dropped, cloud.provenance), longest


def text_of_closed(longest: float, radius: float) -> str:
    """Warning of gaps that were closed, the longest of them given."""
    return (
        f"the map is sparse: neighbouring points of its surfaces are up to {longest:.2g} m apart, and a vehicle of "
        f"radius {radius:g} m passes between them. Such gaps count as walls here, and wider ones as openings: scan "
        "more densely, or look at the route"
    )


def _typical_hole(points: Points, radius: float) -> float:
    """Radius of the holes to close, metres; zero where the map is not sparse, or no surface."""
    sample = np.random.default_rng(0).permutation(len(points))[:_SAMPLE]
    count = min(_NEAREST + 1, len(points))
    length, near = scipy.spatial.KDTree(points).query(points[sample], k=count)
    off = points[near] - points[sample][:, None]
    first = off[:, : _PATCHES[0]]
    values = np.linalg.eigvalsh(_covariance(first))
    if np.mean(values[:, 0] < _FLAT * values[:, 2]) < _FLAT_FRACTION:
        return 0.0
    flat, places = _projected(off)
    reach = 0.5 * length[:, -1] if count < len(points) else np.full(len(sample), np.inf)
    holes = np.zeros(len(sample))
    beside = flat & _empty(places, np.minimum(radius, reach))
    if np.count_nonzero(beside) < _FRACTION * len(sample):
        return 0.0
    surrounded = ~beside
    rho = np.full(len(sample), radius)
    active = np.flatnonzero(beside)
    while len(active) and rho[active[0]] <= _LONGEST * radius:
        holes[active] = rho[active]
        rho[active] *= _GROWTH
        # A disc that reaches beyond the known neighbours says nothing.
        active = active[rho[active] <= reach[active]]
        closed = ~_empty(places[active], rho[active])
        surrounded[active[closed]] = True
        active = active[~closed]
    inner = flat & surrounded
    if np.count_nonzero(inner & (holes > 0)) < _FRACTION * np.count_nonzero(flat):
        return 0.0
    return _MARGIN * _GROWTH * float(np.quantile(holes[inner & (holes > 0)], _TYPICAL))


def _covariance(off: Float[np.ndarray, "k n 3"]) -> Float[np.ndarray, "k 3 3"]:
    centred = off - off.mean(axis=1, keepdims=True)
    return np.einsum("kni,knj->kij", centred, centred)


def _projected(off: Float[np.ndarray, "k n 3"]) -> tuple[Bool[np.ndarray, "k"], Float[np.ndarray, "k n 2"]]:
    """Which points have a tangent plane, and their neighbours in it; those off the plane are put at infinity."""
    flat = np.zeros(len(off), bool)
    axes = np.zeros((len(off), 3, 3))
    for count in _PATCHES:
        values, vectors = np.linalg.eigh(_covariance(off[:, :count]))
        good = (values[:, 0] < _PLANAR * values[:, 1]) & (values[:, 1] > _ROW * values[:, 2]) & ~flat
        axes[good] = vectors[good]
        flat |= good
    local = np.einsum("kni,kij->knj", off, axes)
    beyond = np.abs(local[:, :, 0]) > _SLAB * np.linalg.norm(off, axis=2)
    return flat, np.where(beyond[:, :, None], np.inf, local[:, :, 1:])


def _empty(places: Float[np.ndarray, "k n 2"], rho: Float[np.ndarray, "k"]) -> Bool[np.ndarray, "k"]:
    """Whether a disc of a radius that touches the origin holds none of the other places."""
    angles = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False)
    ways = np.stack([np.cos(angles), np.sin(angles)])
    # |place - rho way|^2 < rho^2  <=>  |place|^2 < 2 rho place . way
    others = places[:, 1:]
    known = np.isfinite(others[:, :, :1])
    others = np.where(known, others, 0.0)
    square = np.where(known[:, :, 0], np.sum(others**2, axis=2), np.inf)
    inside = (1.0 + 1e-6) * square[:, :, None] < 2.0 * rho[:, None, None] * (others @ ways)
    return np.logical_not(np.all(inside.any(axis=1), axis=1))


def _triangles(points: Points, alpha: float, radius: float) -> Float[np.ndarray, "_ 3 3"]:
    """Corners of the Delaunay triangles that a ball of ``alpha`` does not pass, but one of half the radius would."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    far = np.array(list(np.ndindex(2, 2, 2))) * (high - low + 6.0 * size) + low - 3.0 * size
    # Corners of a wide box make flat clouds solid.
    cells = scipy.spatial.Delaunay(np.concatenate([points, far])).simplices
    faces = np.concatenate([np.delete(cells, k, axis=1) for k in range(4)])
    faces = np.unique(np.sort(faces[faces.max(axis=1) < len(points)], axis=1), axis=0)
    corners = points[faces]
    sides = _sides(corners)
    within = (sides.max(axis=1) <= 2.0 * alpha) & (sides.max(axis=1) > _STEP * radius)
    corners, sides = corners[within], sides[within]
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    with np.errstate(divide="ignore"):
        circumradius = sides.prod(axis=1) / (2.0 * double)
    # The sides of a triangle without area bound others.
    return corners[(circumradius <= alpha) & (double > 1e-9 * sides.max(axis=1) ** 2)]


def _sides(corners: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3"]:
    """Lengths of the sides of triangles."""
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def _filled(corners: Float[np.ndarray, "_ 3 3"], step: float) -> Points:
    """Points on triangles, no farther from each other than a step."""
    sides = _sides(corners).max(axis=1)
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
    cells = np.floor((added - added.min(axis=0)) / step).astype(np.int64)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    return added[np.unique(key, return_index=True)[1]]
