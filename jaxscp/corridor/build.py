"""The front door: a cloud and two places in, a corridor out, or the reason why there is none.

The map is judged first. Then the cloud is thinned, a route searched and shortened, and one polytope made about
each leg. Polytopes are left out whose neighbours overlap about as widely without them. Where the method's planes
do not suffice, a polytope is made in a smaller box.

No polytope comes nearer than ``radius`` to a point of the cloud as it was given. Between legs the route keeps
``radius + clearance``, and every polytope holds a capsule of radius ``clearance`` about such a leg. So
consecutive ones overlap in a ball of that radius. Legs that end at a tight start or goal can have less, which
the status tells.

Nobody saw whether space outside the map is free, so its box bounds the corridor, and its lowest point is the
floor. State ``lower`` and ``upper`` to fly outside. A region of ``remove`` that holds start or goal is its deck:
points of it count as obstacles for all legs but the one from there, which does not go behind the deck.
"""

import warnings
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxscp.core.arrays import is_number
from jaxscp.core.obstacles import Obstacles
from jaxscp.corridor.cells import cells_along
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decks import Deck, obstacles_of_leg, split_decks
from jaxscp.corridor.decompose import Cell, Decomposition, InflationFIRI
from jaxscp.corridor.extent import Triple
from jaxscp.corridor.gaps import text_of_closed, with_closed_gaps
from jaxscp.corridor.limits import Limits, flyable
from jaxscp.corridor.map_report import MapError, MapReport, map_report
from jaxscp.corridor.obstacles import padded_obstacles
from jaxscp.corridor.padding import pad as pad
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.precompile import precompile
from jaxscp.corridor.pruning import Segments, chosen, packed, without_redundant
from jaxscp.corridor.route import NoRoute, Route, find_route, legs
from jaxscp.corridor.search_space import nearest_on_segment

_HALVINGS = 3


class CorridorStatus(eqx.Enumeration):
    """How building a corridor ended."""

    found = "found"
    no_route = "no route: the search found no way that keeps the distances asked for"
    narrow = (
        "narrow: some polytopes overlap by less than the clearance asked for, most likely because start or "
        "goal is nearer to an obstacle than radius and clearance together"
    )
    unresolved = "unresolved: points remain inside a polytope; give the method more planes"


class CorridorResult(eqx.Module):
    """A corridor, its route, and how building it ended."""

    corridor: Corridor | None
    """The polytopes, or None without a route. Trust it only where ``status`` is ``found``."""
    route: Route | NoRoute
    """The way through the middle, or why there is none."""
    status: CorridorStatus
    """A ``CorridorStatus``."""
    message: str
    """The status in a sentence, with numbers."""
    seeds: Segments
    """The leg inside each polytope, (polytopes, 2, 3), metres, before padding."""
    overlaps: Float[np.ndarray, "joints"]
    """Radius in metres of the widest ball in each consecutive overlap, before padding."""
    report: MapReport
    """Facts about the map."""
    closed_gap: float = 0.0
    """Longest gap between neighbouring points that was closed, metres."""
    near_obstacles: Obstacles | None = None
    """Obstacle points near the corridor, for the scenario's certificate; None without a corridor."""

    @property
    def found(self) -> bool:
        """Whether the corridor is all that was asked for."""
        return bool(self.status == CorridorStatus.found)


class CorridorOptions(eqx.Module):
    """Options of ``build_corridor``."""

    method: Decomposition = InflationFIRI()
    """How to make a polytope: this, or ``EllipsoidDecomposition()``."""
    clearance: float = 0.1
    """Radius of the ball that consecutive overlaps must hold, metres."""
    lower: Triple | None = None
    """Lower corner of the volume for the vehicle's centre, (3,), metres; None: the map's."""
    upper: Triple | None = None
    """Upper corner of that volume, (3,), metres; None: the map's."""
    remove: Sequence[Polytope] = ()
    """Regions whose points are no obstacles. One that holds start or goal is its deck."""
    voxel: float | None = 0.1
    """Edge of the voxels that the cloud is thinned by, metres; None takes it as it is."""
    longest: float = 6.0
    """Longer legs are halved, metres."""
    cell: float | None = None
    """Edge of the voxels of the route search, metres; None chooses."""
    polytopes: int | None = None
    """Pad to this many by repeating the last one, with the goal as joint."""
    faces: int | None = None
    """Pad to this many rows."""
    near_points: int | None = None
    """Pad the obstacle points near the corridor to this many; None: to a power of two."""
    close_gaps: bool = True
    """Close gaps between neighbours on a sparse surface where the vehicle would pass."""

    def __check_init__(self):
        """Refuse corners that are not three coordinates."""
        for name in ("lower", "upper"):
            if getattr(self, name) is not None:
                _point(name, getattr(self, name))
        _distance("clearance", self.clearance)

    def limits(self, cloud: PointCloud, start: np.ndarray, goal: np.ndarray, radius: float) -> Limits | None:
        """Volume for the vehicle's centre: as asked for, else the map's box; None in free space without limits."""
        if cloud.count == 0 and self.lower is None and self.upper is None:
            return None
        box = flyable(cloud, start, goal, radius)
        lower = box.lower if self.lower is None else np.asarray(self.lower, float)
        upper = box.upper if self.upper is None else np.asarray(self.upper, float)
        return Limits(lower, upper)


def build_corridor(
    cloud: PointCloud | ArrayLike, start: Triple, goal: Triple, radius: float, **options: Any
) -> CorridorResult:
    """Safe flight corridor from start to goal through a point cloud.

    No polytope comes nearer than ``radius`` to a point of the cloud. Steps, limits, decks: ``jaxscp.corridor.build``.

    Args:
        cloud: obstacles, or their positions, (points, 3), metres; an empty array is free space, with a warning.
        start: (3,) metres.
        goal: (3,) metres.
        radius: safety radius of the vehicle, metres.
        options: fields of ``CorridorOptions``: method, clearance, lower, upper, remove, voxel, longest, cell,
            polytopes, faces, near_points, close_gaps.

    Raises:
        MapError: the map contradicts its unit, its frame, or the place of the flight; a ``ValueError``.
        ValueError: start or goal is outside the limits or nearer to an obstacle than the radius. The message says
            how near. Or more polytopes, faces or points are needed than ``polytopes``, ``faces`` or ``near_points``.
        ImportError: scikit-image, of the extra ``clouds``, is not installed.

    Example:
        >>> import jaxscp, numpy as np
        >>> wall = [[0.0, y, z] for y in np.arange(-3, 3, 0.1) for z in np.arange(-3, 3, 0.1)]
        >>> around = {"lower": [-4, -5, -3], "upper": [4, 5, 3]}
        >>> result = jaxscp.corridor.build_corridor(wall, [-2, 0, 0], [2, 0, 0], radius=0.3, **around)
        >>> result.found, result.corridor.count >= 2, bool(result.overlaps.min() >= 0.1)
        (True, True, True)
    """
    settings, cloud = CorridorOptions(**options), PointCloud.at(cloud)
    first, last, radius = _point("start", start), _point("goal", goal), _distance("radius", radius)
    ready = precompile(settings.method, cloud.count)
    report = _accepted(map_report(cloud, first, last, radius, lower=settings.lower, upper=settings.upper))
    limits = settings.limits(cloud, first, last, radius)
    thinned, decks, gap = _prepared(settings, cloud, (first, last), radius)
    lower, upper = (None, None) if limits is None else limits
    searched = {"clearance": settings.clearance, "lower": lower, "upper": upper, "cell": settings.cell}
    route = find_route(thinned, first, last, radius, **searched, decks=decks, closed_gap=gap)
    if isinstance(route, NoRoute):
        return _without_route(route, report, gap)
    seeds = legs(route.points, settings.longest)
    ready()
    cells = _cells(settings, seeds, thinned, decks, radius, limits)
    rows, balls = without_redundant(cells.polytope, settings.clearance)
    corridor = packed(chosen(cells.polytope, rows), seeds[rows], balls[:, :3])
    status, message = _verdict(cells.left, balls[:, 3], settings.clearance, corridor.count)
    on_deck = np.any([np.zeros(thinned.count, bool), *(deck.freed for deck in decks if deck)], axis=0)
    near = padded_obstacles(corridor, thinned, radius + settings.clearance, on_deck, settings.near_points)
    padded = pad(corridor, last, settings.polytopes, settings.faces)
    return CorridorResult(padded, route, status, message, seeds[rows], balls[:, 3], report, gap, near)


def _without_route(route: NoRoute, report: MapReport, gap: float) -> CorridorResult:
    nothing, reason = (np.empty((0, 2, 3)), np.empty(0)), f"no route: {route.reason}"
    return CorridorResult(None, route, CorridorStatus.no_route, reason, *nothing, report, gap)


def _accepted(report: MapReport) -> MapReport:
    """The report of a map, with its warnings given.

    Raises:
        MapError: the map is refused.
    """
    if report.refused:
        raise MapError(f"{report.source}: {'; '.join(report.refused)}")
    for warning in report.warnings:
        warnings.warn(f"{report.source}: {warning}", stacklevel=3)
    return report


def _prepared(
    options: CorridorOptions, cloud: PointCloud, ends: tuple[np.ndarray, np.ndarray], radius: float
) -> tuple[PointCloud, tuple[Deck | None, Deck | None], float]:
    """The thinned cloud without gaps or removed regions, the decks in it, and the longest gap closed, metres."""
    thinned = cloud if options.voxel is None else cloud.thinned(options.voxel)
    closed, gap = with_closed_gaps(thinned, radius) if options.close_gaps else (thinned, 0.0)
    if gap:
        warnings.warn(text_of_closed(gap, radius), stacklevel=3)
    if not options.remove:
        return closed, (None, None), gap
    if gap:
        return *split_decks(closed, options.remove, ends, radius, None), gap
    return *split_decks(cloud, options.remove, ends, radius, options.voxel), gap


def _point(name: str, value: Triple) -> Float[np.ndarray, "3"]:
    try:
        point = np.asarray(value, float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be three coordinates in metres, (3,), got {value!r}") from None
    if point.shape != (3,):
        raise ValueError(f"{name} must be three coordinates in metres, got shape {point.shape}")
    return point


def _distance(name: str, value: Any) -> float:
    if not is_number(value):
        raise ValueError(f"{name} must be one number in metres, got {value!r}")
    return float(value)


def _cells(
    options: CorridorOptions,
    seeds: Segments,
    cloud: PointCloud,
    decks: tuple[Deck | None, Deck | None],
    radius: float,
    limits: Limits | None,
) -> Cell:
    """Cells along all legs; those from a deck have obstacles and limits of their own."""
    own: dict[int, list[tuple[Deck, np.ndarray]]] = {}
    for deck, leg, end in zip(decks, (0, len(seeds) - 1), (seeds[0, 0], seeds[-1, 1]), strict=True):
        if deck is not None:
            own.setdefault(leg, []).append((deck, end))
    others = [leg for leg in range(len(seeds)) if leg not in own]
    parts = {} if not others else {tuple(others): _resolved(options, seeds[others], cloud, radius, limits)}
    for leg, ends in own.items():
        bounds = limits or Limits(np.full(3, -np.inf), np.full(3, np.inf))
        for deck, end in ends:
            bounds = deck.limits(bounds, end)
        nearest = nearest_on_segment(cloud.points, *seeds[leg])
        obstacles = obstacles_of_leg(cloud, [deck for deck, _ in ends], nearest, radius)
        parts[(leg,)] = _resolved(options, seeds[leg : leg + 1], obstacles, radius, bounds)
    order = np.argsort(np.concatenate([np.array(legs) for legs in parts]))
    return jax.tree.map(lambda *rows: np.concatenate(rows)[order], *parts.values())


def _resolved(
    options: CorridorOptions, segments: Segments, cloud: PointCloud, radius: float, limits: Limits | None
) -> Cell:
    """Cells along segments; those that left points inside are made again in a box of half the reach."""
    method, clearance = options.method, options.clearance
    lower, upper = (None, None) if limits is None else limits
    cells = cells_along(method, segments, cloud, radius, clearance, lower, upper)
    for _ in range(_HALVINGS):
        again = np.flatnonzero(cells.left)
        # A box that reaches less than the clearance would cut the balls that the overlaps must hold.
        if not len(again) or 0.5 * method.reach < clearance:
            break
        method = eqx.tree_at(lambda m: m.reach, method, 0.5 * method.reach)
        smaller = cells_along(method, segments[again], cloud, radius, clearance, lower, upper)
        cells = jax.tree.map(lambda old, new, rows=again: _replaced(old, rows, new), cells, smaller)
    return cells


def _replaced(array: np.ndarray, rows: np.ndarray, new: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[rows] = new
    return array


def _verdict(left, overlaps, clearance: float, count: int) -> tuple[CorridorStatus, str]:
    if np.any(left):
        where = ", ".join(str(k) for k in np.flatnonzero(left))
        return CorridorStatus.unresolved, f"{CorridorStatus[CorridorStatus.unresolved]} (legs {where})"
    least = float(overlaps.min()) if len(overlaps) else float("inf")
    # The capsules guarantee the clearance up to rounding.
    if least < clearance - 1e-6:
        return (
            CorridorStatus.narrow,
            f"{CorridorStatus[CorridorStatus.narrow]} (least overlap {least:.3f} m, asked {clearance:.3f} m)",
        )
    return CorridorStatus.found, f"found: {count} polytopes, least overlap {least:.3f} m"
