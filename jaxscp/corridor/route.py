"""A way through a point cloud: search on a voxel grid, then shortcuts at any angle. Host side, NumPy.

The way keeps ``radius + clearance`` from every point. The radius is the vehicle's. The clearance lets the polytopes
about consecutive segments overlap in a ball of that radius. Start and goal need the radius alone.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decks import Deck
from jaxscp.corridor.limits import Limits, Point
from jaxscp.corridor.search_space import Space, search_space
from jaxscp.corridor.search_space import segment_distance as segment_distance
from jaxscp.corridor.voxel_search import FINEST, Blocked, Waypoints, cell_count, first_edge, search

_CELLS_AT_MOST = 6_000_000
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
    """The obstacle, in a sentence."""
    cell: float
    """Edge of the finest voxels searched, metres."""


class RouteOptions(eqx.Module):
    """Options of ``find_route``."""

    clearance: float = 0.1
    """Distance to keep besides the radius, metres; only the first and the last leg may do with less."""
    lower: Point | None = None
    """Lower corner of the volume to search, (3,), metres; by default ``margin`` about everything."""
    upper: Point | None = None
    """Upper corner of the volume to search, (3,), metres."""
    margin: float = 2.0
    """Distance that the default reaches beyond cloud, start and goal, metres."""
    cell: float | None = None
    """Edge of a voxel, metres; by default it follows from the volume, the radius and the memory."""
    decks: tuple[Deck | None, Deck | None] = (None, None)
    """Decks of start and goal."""
    closed_gap: float = 0.0
    """Longest gap between points of a map that further points of the cloud close, metres."""


def find_route(
    cloud: PointCloud | ArrayLike, start: Point, goal: Point, radius: float, **options: Any
) -> Route | NoRoute:
    """Shortest way on a voxel grid that keeps ``radius + clearance``, then shortened at any angle.

    Distances are to the points themselves, not to their voxels, and no edge of the grid comes nearer than asked.
    Where no way is found, finer voxels are tried before that is said. The search is scikit-image's
    ``MCP_Geometric`` (Dijkstra over 26 neighbours).

    Args:
        cloud: obstacles, or their positions as an array, (points, 3), metres.
        start: (3,) metres.
        goal: (3,) metres.
        radius: safety radius of the vehicle, metres; the cloud's spread is added.
        options: fields of ``RouteOptions``: clearance, lower, upper, margin, cell, decks, closed_gap.

    Raises:
        ValueError: start or goal is not finite, outside the limits, or nearer to a point than the radius.
        ImportError: scikit-image is not installed.

    Example:
        >>> wall = [[0.0, y, z] for y in np.arange(-3, 3, 0.1) for z in np.arange(-3, 3, 0.1)]
        >>> route = find_route(PointCloud.of(wall), np.array([-2.0, 0, 0]), np.array([2.0, 0, 0]), 0.3)
        >>> route.length > 7.0, bool(route.clearance.min() >= 0.3)
        (True, True)
    """
    start, goal, chosen = np.asarray(start, float), np.asarray(goal, float), RouteOptions(**options)
    cloud = PointCloud.at(cloud)
    space = _space(cloud, start, goal, radius, chosen)
    for end, (name, point) in enumerate((("start", start), ("goal", goal))):
        place = f"{name} ({point[0]:g}, {point[1]:g}, {point[2]:g})"
        _check_end(place, point, space.at_end(end, point), space, _reasons(cloud.spread, chosen.closed_gap))
    if space.along(start, goal) >= space.roomy:
        # Nothing is in the way, so nothing needs a grid.
        return _measured(np.stack([start, goal]), space, cloud.spread, float("nan"))

    edge = chosen.cell or first_edge(space)
    for _ in range(_ATTEMPTS):
        found = search(space, start, goal, edge)
        if not isinstance(found, Blocked):
            return _measured(_shortened(found, space), space, cloud.spread, edge)
        if found.proven or chosen.cell or edge <= FINEST or cell_count(space, edge / 2) > _CELLS_AT_MOST:
            break
        edge = edge / 2
    return NoRoute(found.reason, edge)


def _space(cloud: PointCloud, start: Point, goal: Point, radius: float, options: RouteOptions) -> Space:
    if not (np.isfinite(start).all() and np.isfinite(goal).all()):
        raise ValueError(f"start and goal must be finite, got {start} and {goal}")
    clearance = options.clearance
    if not (radius >= 0 and clearance >= 0):
        raise ValueError(f"radius and clearance must not be negative, got {radius} m and {clearance} m")
    corners = np.stack([*cloud.extent, start, goal] if cloud.count else [start, goal])
    lower = (
        corners.min(axis=0) - options.margin if options.lower is None else np.asarray(options.lower, float)
    )
    upper = (
        corners.max(axis=0) + options.margin if options.upper is None else np.asarray(options.upper, float)
    )
    return search_space(cloud, Limits(lower, upper), radius, clearance, options.decks)


def _reasons(spread: float, gap: float) -> str:
    """Why a place may be too near to an obstacle, besides the points of the map themselves."""
    grown = f" (of which {spread:.3f} m for the thinning of the cloud)" if spread else ""
    closed = (
        f". Points that close gaps of up to {gap:.2g} m in the map count as obstacles; where its gaps are open, leave "
        "them so: close_gaps=False in Python"
    )
    return grown + (closed if gap else "")


def _check_end(place: str, point: Point, distance: float, space: Space, reasons: str) -> None:
    if np.any(point < space.lower) or np.any(point > space.upper):
        raise ValueError(
            f"{place} is outside the limits {space.lower} to {space.upper}; state wider ones: lower= and upper= "
            "(--lower, --upper)"
        )
    if distance < space.radius:
        raise ValueError(
            f"{place} is {distance:.3f} m from the nearest obstacle point, inside the safety radius of "
            f"{space.radius:.3f} m{reasons}. If the vehicle stands there, free its deck: --crop 0.5 on the command "
            "line, remove=[box(...)] in Python. Else ask for a smaller radius (--radius)"
        )


def _shortened(path: Waypoints, space: Space) -> Float[np.ndarray, "_ 3"]:
    """Leave out vertices where straight flight keeps the roomy distance; legs to tight ends stay."""

    def may_skip(i: int, k: int) -> bool:
        return k == i + 1 or space.along(path[i], path[k]) >= space.roomy

    chosen, here = [0], 0
    while here < len(path) - 1:
        here = _furthest(here, len(path) - 1, may_skip)
        chosen.append(here)
    return path[chosen]


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
    distances = [space.to_segment(a, b) - spread for a, b in pairwise(points)]
    return Route(points, np.array(distances), cell)


def legs(route: Float[np.ndarray, "vertices 3"], longest: float) -> Float[np.ndarray, "legs 2 3"]:
    """Legs of a polyline, those longer than ``longest`` metres cut into equal parts.

    Example:
        >>> legs(np.array([[0.0, 0, 0], [4.0, 0, 0]]), 3.0)[:, :, 0].tolist()
        [[0.0, 2.0], [2.0, 4.0]]
    """
    parts = []
    for start, end in pairwise(route):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / longest)))
        ways = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start)
        parts.append(np.stack([ways[:-1], ways[1:]], axis=1))
    return np.concatenate(parts)
