"""The front door: a cloud and two places in, a corridor out, or the reason why there is none."""

from collections.abc import Sequence
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxscp.corridor.cells import cells_along, consecutive_overlaps
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decompose import Cell, Decomposition, InflationFIRI
from jaxscp.corridor.polytopes import Corridor, Polytope
from jaxscp.corridor.route import NoRoute, Route, find_route
from jaxscp.corridor.shapes import needed_faces

_HALVINGS = 3

Segments = Float[np.ndarray, "segments 2 3"]


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
    """A corridor, where it came from, and what is to be said about it."""

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

    @property
    def found(self) -> bool:
        """Whether the corridor is all that was asked for."""
        return bool(self.status == CorridorStatus.found)


def build_corridor(
    cloud: PointCloud,
    start: ArrayLike,
    goal: ArrayLike,
    radius: float,
    *,
    method: Decomposition | None = None,
    clearance: float = 0.1,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    remove: Sequence[Polytope] = (),
    voxel: float | None = 0.1,
    longest: float = 6.0,
    cell: float | None = None,
    polytopes: int | None = None,
    faces: int | None = None,
) -> CorridorResult:
    """Safe flight corridor from start to goal through a point cloud.

    The cloud is thinned, a route searched and shortened, one polytope made about each leg, and polytopes
    left out whose neighbours overlap about as widely without them; where the method's planes do not suffice,
    a polytope is made in a smaller box. No polytope comes nearer than ``radius``
    to a point of the cloud as it was given. Between legs the route keeps ``radius + clearance``, every
    polytope holds a capsule of radius ``clearance`` about such a leg, and so consecutive ones overlap in a
    ball of that radius without any repair; legs that end at a tight start or goal can fall short, which the
    status tells.

    Args:
        cloud: obstacles; an empty one is free space.
        start: (3,) metres.
        goal: (3,) metres.
        radius: safety radius of the vehicle, metres.
        method: ``InflationFIRI()`` by default, or ``EllipsoidDecomposition()``.
        clearance: radius of the ball that consecutive overlaps must hold, metres.
        lower: (3,) lower corner of the volume that the vehicle's centre may use, metres; None: no limit.
        upper: (3,) its upper corner, metres; None: no limit.
        remove: regions whose points are no obstacles, such as the carrier's own deck.
        voxel: edge of the voxels that the cloud is thinned by, metres; None takes it as it is.
        longest: longer legs are halved, metres.
        cell: edge of the voxels of the route search, metres; None chooses.
        polytopes: pad to this many by repeating the last one, with the goal as joint.
        faces: pad to this many rows.

    Raises:
        ValueError: start or goal is nearer to an obstacle than the radius (the message says how near), is
            outside the limits, or more polytopes or faces are needed than ``polytopes`` or ``faces``.
        ImportError: scikit-image, of the extra ``clouds``, is not installed.

    Example:
        >>> import jaxscp, numpy as np
        >>> wall = [[0.0, y, z] for y in np.arange(-3, 3, 0.1) for z in np.arange(-3, 3, 0.1)]
        >>> cloud = jaxscp.corridor.PointCloud.of(wall)
        >>> result = jaxscp.corridor.build_corridor(cloud, [-2, 0, 0], [2, 0, 0], radius=0.3)
        >>> result.found, result.corridor.count >= 2, bool(result.overlaps.min() >= 0.1)
        (True, True, True)
    """
    method = InflationFIRI() if method is None else method
    first, last = _point("start", start), _point("goal", goal)
    low = None if lower is None else _point("lower", lower)
    high = None if upper is None else _point("upper", upper)
    for region in remove:
        cloud = cloud.without(region)
    if voxel is not None:
        cloud = cloud.thinned(voxel)
    route = find_route(cloud, first, last, radius, clearance=clearance, lower=low, upper=high, cell=cell)
    if isinstance(route, NoRoute):
        return CorridorResult(
            None,
            route,
            CorridorStatus.no_route,
            f"no route: {route.reason}",
            np.empty((0, 2, 3)),
            np.empty(0),
        )
    seeds = legs(route.points, longest)
    cells = _resolved(method, seeds, cloud, radius, clearance, low, high)
    kept, balls = _without_redundant(cells.polytope, clearance)
    seeds = seeds[kept]
    corridor = _packed(_chosen(cells.polytope, kept), seeds, balls[:, :3])
    status, message = _verdict(cells.left, balls[:, 3], clearance, corridor.count)
    return CorridorResult(pad(corridor, last, polytopes, faces), route, status, message, seeds, balls[:, 3])


def _point(name: str, value: ArrayLike) -> Float[np.ndarray, "3"]:
    point = np.asarray(value, float)
    if point.shape != (3,):
        raise ValueError(f"{name} must be three coordinates in metres, got shape {point.shape}")
    return point


def legs(route: Float[np.ndarray, "vertices 3"], longest: float) -> Segments:
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


def _resolved(method, segments, cloud, radius, clearance, lower, upper) -> Cell:
    """Cells along segments; those that left points inside are made again in a box of half the reach."""
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


_overlaps = jax.jit(consecutive_overlaps, static_argnames="skip")


def _balls(polytopes: Polytope, skip: int) -> Float[np.ndarray, "pairs 4"]:
    """Centre and radius of the widest ball in each overlap; rows padded so that few shapes are compiled."""
    count = len(polytopes.offsets)
    if count <= skip:
        return np.empty((0, 4))
    padded = jax.tree.map(
        lambda rows: np.concatenate([rows, np.repeat(rows[-1:], -count % 8, axis=0)]), polytopes
    )
    ball = _overlaps(jax.tree.map(jnp.asarray, padded), skip=skip)
    found = np.concatenate([np.asarray(ball.centre), np.asarray(ball.radius)[:, None]], axis=1)
    return found[: count - skip].astype(float)


def _without_redundant(
    polytopes: Polytope, clearance: float
) -> tuple[list[int], Float[np.ndarray, "joints 4"]]:
    """Which polytopes to keep, and the overlaps between those."""
    kept = list(range(len(polytopes.offsets)))
    while True:
        left = _chosen(polytopes, kept)
        near, far = _balls(left, 1), _balls(left, 2)
        dropped = _droppable(near[:, 3], far[:, 3], clearance)
        if not dropped:
            return kept, near
        kept = [kept[place] for place in range(len(kept)) if place not in dropped]


def _chosen(polytopes: Polytope, kept: list[int]) -> Polytope:
    return jax.tree.map(lambda rows: rows[np.array(kept)], polytopes)


def _droppable(
    near: Float[np.ndarray, "joints"], far: Float[np.ndarray, "seconds"], clearance: float
) -> set[int]:
    """Polytopes, no two of them neighbours, without which the way stays at least half as wide."""
    dropped: set[int] = set()
    for middle in range(1, len(far) + 1):
        enough = max(clearance, 0.5 * min(near[middle - 1], near[middle]))
        if middle - 1 not in dropped and far[middle - 1] >= enough:
            dropped.add(middle)
    return dropped


def _packed(polytopes: Polytope, seeds: Segments, joints: Float[np.ndarray, "joints 3"]) -> Corridor:
    """Rows that are not faces left out, the rest moved to the front."""
    cells = [
        Polytope(jnp.asarray(n), jnp.asarray(b))
        for n, b in zip(polytopes.normals, polytopes.offsets, strict=True)
    ]
    needed = [needed_faces(cell, seed.mean(axis=0)) for cell, seed in zip(cells, seeds, strict=True)]
    most = max(len(rows) for rows in needed)
    normals = np.zeros((len(cells), most, 3))
    offsets = np.ones((len(cells), most))
    for k, (cell, rows) in enumerate(zip(cells, needed, strict=True)):
        normals[k, : len(rows)] = np.asarray(cell.normals)[rows]
        offsets[k, : len(rows)] = np.asarray(cell.offsets)[rows]
    return Corridor(jnp.asarray(normals), jnp.asarray(offsets), jnp.asarray(joints))


def pad(
    corridor: Corridor, goal: ArrayLike, polytopes: int | None = None, faces: int | None = None
) -> Corridor:
    """A corridor of a given size: the last polytope repeated with the goal as joint, rows 0 . p <= 1 added.

    Args:
        corridor: what to pad.
        goal: (3,) a point in the last polytope, metres.
        polytopes: how many to make it; None leaves their number.
        faces: how many rows to make it; None leaves their number.

    Raises:
        ValueError: the corridor is larger than that already.

    Example:
        >>> import jaxscp
        >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [1, 2, 3])], joints=[])
        >>> padded = pad(room, [0.5, 0.5, 0.5], polytopes=4, faces=10)
        >>> padded.normals.shape, padded.joints.shape
        ((4, 10, 3), (3, 3))
    """
    count, rows = corridor.offsets.shape
    polytopes, faces = polytopes or count, faces or rows
    if count > polytopes or rows > faces:
        raise ValueError(
            f"the corridor has {count} polytopes of {rows} faces, more than the "
            f"{polytopes} of {faces} asked for"
        )
    more, goal = polytopes - count, jnp.asarray(goal, corridor.offsets.dtype)
    normals = jnp.pad(corridor.normals, ((0, 0), (0, faces - rows), (0, 0)))
    offsets = jnp.pad(corridor.offsets, ((0, 0), (0, faces - rows)), constant_values=1.0)
    return Corridor(
        jnp.concatenate([normals, jnp.repeat(normals[-1:], more, axis=0)]),
        jnp.concatenate([offsets, jnp.repeat(offsets[-1:], more, axis=0)]),
        jnp.concatenate([corridor.joints, jnp.broadcast_to(goal, (more, 3))]),
    )


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
