"""A way through a point cloud: search on a voxel grid, then shortcuts at any angle. Host side, NumPy.

The way keeps ``radius + clearance`` from every point: the radius is the vehicle's, and the clearance lets the
polytopes about consecutive segments overlap in a ball of that radius. Start and goal need the radius alone.
"""

from collections.abc import Callable
from itertools import pairwise

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float

from jaxscp.corridor.clouds import PointCloud

Point = Float[np.ndarray, "3"]
Waypoints = Float[np.ndarray, "vertices 3"]

_CELLS_AT_FIRST = 300_000
_CELLS_AT_MOST = 6_000_000
_FINEST = 0.05
_ATTEMPTS = 3


class Route(eqx.Module):
    """A polyline from start to goal that keeps the safety radius and the clearance between its ends."""

    points: Waypoints
    """Vertices, (vertices, 3), start first, metres."""
    clearance: Float[np.ndarray, "segments"]
    """Distance from each segment to the nearest obstacle, metres (to the points, less the cloud's spread)."""
    cell: float
    """Edge of the voxels searched, metres."""

    @property
    def length(self) -> float:
        """Length of the polyline, metres."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


class NoRoute(eqx.Module):
    """There is no way through, as far as the search could see."""

    reason: str
    """What stands in the way, in a sentence."""
    cell: float
    """Edge of the finest voxels searched, metres."""


class Blocked(eqx.Module):
    """What a search on one grid found in the way."""

    reason: str
    proven: bool
    """Whether finer voxels cannot help either."""


class Space(eqx.Module):
    """Where obstacles are, and how near the vehicle may come."""

    points: Float[np.ndarray, "points 3"]
    tree: "scipy.spatial.KDTree | None"
    lower: Point
    upper: Point
    radius: float
    roomy: float

    def to_points(self, places: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Distance from each place to the nearest obstacle point, metres; inf where there is none."""
        if self.tree is None:
            return np.full(places.shape[:-1], np.inf)
        return np.asarray(self.tree.query(places)[0])

    def to_limits(self, places: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Distance to the limits as if they were points: their clearance is kept, their radius is in them."""
        return self.radius + np.minimum(places - self.lower, self.upper - places).min(axis=-1)

    def distance(self, places: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Distance from each place to the nearest of points and limits, metres."""
        return np.minimum(self.to_points(places), self.to_limits(places))

    def along(self, start: Point, end: Point) -> float:
        """Distance from a segment to points and limits, capped at the roomy distance, metres."""
        low, high = np.minimum(start, end) - self.roomy, np.maximum(start, end) + self.roomy
        near = np.flatnonzero((self.points[:, 0] >= low[0]) & (self.points[:, 0] <= high[0]))
        for axis in (1, 2):
            column = self.points[near, axis]
            near = near[(column >= low[axis]) & (column <= high[axis])]
        limits = float(self.to_limits(np.stack([start, end])).min())
        return min(self.roomy, limits, segment_distance(self.points[near], start, end))


def segment_distance(points: Float[np.ndarray, "points 3"], start: Point, end: Point) -> float:
    """Distance from a segment to the nearest of some points, metres; inf where there is none.

    Example:
        >>> segment_distance(np.array([[1.0, 2.0, 0.0]]), np.zeros(3), np.array([4.0, 0.0, 0.0]))
        2.0
    """
    if points.shape[0] == 0:
        return float("inf")
    along = end - start
    length2 = float(along @ along)
    share = np.clip((points - start) @ along / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(points))
    return float(np.sqrt(np.min(np.sum((points - start - share[:, None] * along) ** 2, axis=1))))


def find_route(
    cloud: PointCloud,
    start: Point,
    goal: Point,
    radius: float,
    *,
    clearance: float = 0.1,
    lower: Point | None = None,
    upper: Point | None = None,
    margin: float = 2.0,
    cell: float | None = None,
) -> Route | NoRoute:
    """Shortest way on a voxel grid that keeps ``radius + clearance``, then shortened at any angle.

    Distances are to the points themselves, not to voxels they fall in, and no edge of the grid comes
    nearer than asked. Where no way is found, finer voxels are tried before that is said. The search is
    scikit-image's ``MCP_Geometric`` (Dijkstra over 26 neighbours).

    Args:
        cloud: obstacles.
        start: (3,) metres.
        goal: (3,) metres.
        radius: safety radius of the vehicle, metres; the cloud's spread is added.
        clearance: room to keep besides, metres; only the first and the last leg may do with less.
        lower: (3,) lower corner of the volume to search; by default ``margin`` about everything.
        upper: (3,) its upper corner.
        margin: how far that default reaches beyond cloud, start and goal, metres.
        cell: edge of a voxel in metres; by default chosen from the volume, the radius and the memory.

    Raises:
        ValueError: start or goal is not finite, outside the limits, or nearer to a point than the radius.
        ImportError: scikit-image is not installed.

    Example:
        >>> wall = [[0.0, y, z] for y in np.arange(-3, 3, 0.1) for z in np.arange(-3, 3, 0.1)]
        >>> route = find_route(PointCloud.of(wall), np.array([-2.0, 0, 0]), np.array([2.0, 0, 0]), 0.3)
        >>> route.length > 7.0, bool(route.clearance.min() >= 0.3)
        (True, True)
    """
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    space = _space(cloud, start, goal, radius, clearance, lower, upper, margin)
    for name, point in (("start", start), ("goal", goal)):
        _check_end(name, point, space, cloud.spread)
    if space.along(start, goal) >= space.roomy:
        # Nothing is in the way, so nothing needs a grid.
        return _measured(np.stack([start, goal]), space, cloud.spread, float("nan"))

    edge = cell or _first_edge(space)
    for _ in range(_ATTEMPTS):
        found = _search(space, start, goal, edge)
        if not isinstance(found, Blocked):
            return _measured(_shortened(found, space), space, cloud.spread, edge)
        if found.proven or cell or edge <= _FINEST or _cells(space, edge / 2) > _CELLS_AT_MOST:
            break
        edge = edge / 2
    return NoRoute(found.reason, edge)


def _space(cloud, start, goal, radius, clearance, lower, upper, margin) -> Space:
    if not (np.isfinite(start).all() and np.isfinite(goal).all()):
        raise ValueError(f"start and goal must be finite, got {start} and {goal}")
    if not (radius >= 0 and clearance >= 0):
        raise ValueError(f"radius and clearance must not be negative, got {radius} m and {clearance} m")
    corners = np.stack([*cloud.extent, start, goal] if cloud.count else [start, goal])
    lower = corners.min(axis=0) - margin if lower is None else np.asarray(lower, float)
    upper = corners.max(axis=0) + margin if upper is None else np.asarray(upper, float)
    keep = radius + cloud.spread
    near = np.all(
        (cloud.points > lower - keep - clearance) & (cloud.points < upper + keep + clearance), axis=1
    )
    points = cloud.points[near]
    tree = scipy.spatial.KDTree(points) if points.size else None
    return Space(points, tree, lower, upper, keep, keep + clearance)


def _check_end(name: str, point: Point, space: Space, spread: float) -> None:
    place = f"{name} ({point[0]:g}, {point[1]:g}, {point[2]:g})"
    if np.any(point < space.lower) or np.any(point > space.upper):
        raise ValueError(f"{place} is outside the limits {space.lower} to {space.upper}")
    distance = float(space.to_points(point[None])[0])
    if distance < space.radius:
        grown = f" (of which {spread:.3f} m for the thinning of the cloud)" if spread else ""
        raise ValueError(
            f"{place} is {distance:.3f} m from the nearest obstacle point, inside the safety radius of "
            f"{space.radius:.3f} m{grown}"
        )


def _cells(space: Space, edge: float) -> float:
    return float(np.prod(np.ceil((space.upper - space.lower) / edge) + 1))


def _first_edge(space: Space) -> float:
    """Voxels no larger than gaps that matter, unless that makes too many of them."""
    by_number = float(np.cbrt(np.prod(np.maximum(space.upper - space.lower, _FINEST)) / _CELLS_AT_FIRST))
    return max(by_number, min(0.2, max(0.5 * space.radius, _FINEST)))


def _search(space: Space, start: Point, goal: Point, edge: float) -> Waypoints | Blocked:
    """Voxel path between the two ends, or why there is none."""
    try:
        from skimage.graph import MCP_Geometric
    except ImportError as error:
        raise ImportError("the route search needs scikit-image: pip install 'jaxscp[clouds]'") from error
    shape = np.ceil((space.upper - space.lower) / edge).astype(int) + 1
    # Voxel centres fill the limits evenly, and none is outside.
    centres = [
        np.linspace(low, high, n) for low, high, n in zip(space.lower, space.upper, shape, strict=True)
    ]
    step = np.array([axis[1] - axis[0] if axis.size > 1 else edge for axis in centres])
    limits = space.to_limits(np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1))
    distance = np.minimum(_grid_distance(space, centres, step), limits)
    free = distance >= _edge_safe(space.roomy, step)
    ends = [_entrances(point, space, centres, step, free) for point in (start, goal)]
    for name, end in zip(("start", "goal"), ends, strict=True):
        if not len(end):
            reason = f"{name} is hemmed in: it sees no place that keeps {space.roomy:.3g} m from every point"
            return Blocked(f"{reason} (voxels of {edge:.3g} m)", proven=False)
    search = MCP_Geometric(np.where(free, 1.0, -1.0), sampling=tuple(step))
    reached, _ = search.find_costs(
        [tuple(c) for c in ends[0]], [tuple(c) for c in ends[1]], find_all_ends=False
    )
    costs = reached[tuple(ends[1].T)]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        squeezed = _connected(distance >= _edge_safe(space.radius, step), ends)
        reason = _walled_off(free, ends, float(np.prod(step)), edge, space, squeezed)
        return Blocked(reason, proven=_proven(space, start, goal, distance, step))
    path = np.array(search.traceback(tuple(ends[1][best])))
    middle = np.stack([axis[path[:, i]] for i, axis in enumerate(centres)], axis=1)
    return np.concatenate([start[None], middle, goal[None]])


def _edge_safe(keep: float, step: np.ndarray) -> float:
    """Distance that both ends of an edge of the grid need for the whole edge to keep another."""
    return float(np.hypot(keep, 0.5 * np.linalg.norm(step)))


def _grid_distance(space: Space, centres: list[np.ndarray], step: np.ndarray) -> np.ndarray:
    """Distance of every voxel centre from the nearest point, exact where it decides anything."""
    shape = tuple(axis.size for axis in centres)
    if space.tree is None:
        return np.full(shape, np.inf)
    # A distance transform between voxels, padded for points just outside, is off by half a diagonal at most.
    pad = np.ceil(space.roomy / step).astype(int) + 1
    occupied = np.zeros(np.array(shape) + 2 * pad, bool)
    place = np.rint((space.points - space.lower) / step).astype(int) + pad
    place = place[np.all((place >= 0) & (place < occupied.shape), axis=1)]
    occupied[tuple(place.T)] = True
    if not occupied.any():
        return np.full(shape, np.inf)
    away = scipy.ndimage.distance_transform_edt(~occupied, sampling=tuple(step))
    away = np.asarray(away)[tuple(slice(p, p + n) for p, n in zip(pad, shape, strict=True))]
    half = 0.5 * float(np.linalg.norm(step))
    doubtful = np.argwhere((away > space.radius - half) & (away < _edge_safe(space.roomy, step) + half))
    exact = np.stack([axis[doubtful[:, i]] for i, axis in enumerate(centres)], axis=1)
    distance = np.where(away <= space.radius - half, 0.0, away)
    distance[tuple(doubtful.T)] = space.to_points(exact)
    return distance


def _entrances(
    point: Point, space: Space, centres: list[np.ndarray], step: np.ndarray, free: Bool[np.ndarray, "x y z"]
) -> np.ndarray:
    """Free voxels that a straight flight from a point reaches, with the clearance if the point has it."""
    keep = space.roomy if float(space.distance(point[None])[0]) >= space.roomy else space.radius
    shape = np.array(free.shape)
    nearest = np.rint((point - space.lower) / step).astype(int)
    for reach in (1, 2, 4):
        low, high = np.maximum(nearest - reach, 0), np.minimum(nearest + reach + 1, shape)
        block = np.argwhere(free[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]) + low
        places = np.stack([axis[block[:, i]] for i, axis in enumerate(centres)], axis=1)
        order = np.argsort(np.linalg.norm(places - point, axis=1))[:64]
        seen = [i for i in order if space.along(point, places[i]) >= keep]
        if seen:
            return block[seen]
    return np.empty((0, 3), int)


def _regions(free: np.ndarray) -> np.ndarray:
    return np.asarray(scipy.ndimage.label(free, structure=np.ones((3, 3, 3)))[0])  # pyright: ignore[reportIndexIssue]


def _connected(free: np.ndarray, ends: list[np.ndarray]) -> bool:
    regions = _regions(free)
    first, last = (set(np.unique(regions[tuple(end.T)])) - {0} for end in ends)
    return bool(first & last)


def _proven(space: Space, start: Point, goal: Point, distance: np.ndarray, step: np.ndarray) -> bool:
    """Whether no way exists at all: one would only pass voxels that are at most half a diagonal nearer."""
    ends = np.stack([start, goal])
    tight = bool(np.any(space.distance(ends) < space.roomy))
    keep = (space.radius if tight else space.roomy) - 0.5 * float(np.linalg.norm(step))
    return not _connected(distance >= keep, list(np.rint((ends - space.lower) / step).astype(int)[:, None]))


def _walled_off(
    free: np.ndarray, ends: list[np.ndarray], volume: float, edge: float, space: Space, squeezed: bool
) -> str:
    """Why there is no way: what each end can reach, or that only the clearance is lacking."""
    if squeezed:
        return (
            f"a way keeps the safety radius of {space.radius:.3g} m, but none leaves the clearance of "
            f"{space.roomy - space.radius:.3g} m besides: ask for less clearance (voxels of {edge:.3g} m)"
        )
    regions = _regions(free)
    sizes = [np.isin(regions, np.unique(regions[tuple(end.T)])).sum() * volume for end in ends]
    return (
        f"no way from start to goal keeps {space.roomy:.3g} m from every point: start reaches "
        f"{sizes[0]:.3g} m^3, goal {sizes[1]:.3g} m^3, and these do not touch (voxels of {edge:.3g} m)"
    )


def _shortened(path: Waypoints, space: Space) -> Float[np.ndarray, "kept 3"]:
    """Leave out vertices where straight flight keeps the roomy distance; legs to tight ends stay."""

    def may_skip(i: int, k: int) -> bool:
        return k == i + 1 or space.along(path[i], path[k]) >= space.roomy

    kept, here = [0], 0
    while here < len(path) - 1:
        here = _furthest(here, len(path) - 1, may_skip)
        kept.append(here)
    return path[kept]


def _furthest(here: int, last: int, may_skip: Callable[[int, int], bool]) -> int:
    """Furthest vertex reached by doubling steps and then bisection; sight is nearly monotone along a path."""
    good, step = here + 1, 2
    while here + step <= last and may_skip(here, here + step):
        good, step = here + step, step * 2
    bad = min(here + step, last + 1)
    if bad == last + 1 and may_skip(here, last):
        return last
    while bad - good > 1:
        middle = (good + bad) // 2
        if may_skip(here, middle):
            good = middle
        else:
            bad = middle
    return good


def _measured(points: Waypoints, space: Space, spread: float, cell: float) -> Route:
    distances = [segment_distance(space.points, a, b) - spread for a, b in pairwise(points)]
    return Route(points, np.array(distances), cell)
