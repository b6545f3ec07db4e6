"""One polytope a leg of a route, and the overlaps between them: on the device, in shapes known beforehand."""

from itertools import islice

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from jaxscp.core.types import Vector3
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decompose import Cell, Decomposition, Seed, seed_of
from jaxscp.corridor.overlaps import Ball, overlap_balls
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor

_LEGS_A_CALL = 4
_SMALLEST_BUCKET = 16384
"""Points that each leg of a call is padded to, or a power of four times as many. To compile a size takes seconds; to
pass over padding takes milliseconds."""
_MARGIN = 1e-3
"""How much farther than its box the host looks for a segment's points, metres."""


class Chain(eqx.Module):
    """Polytopes along a route, and how well they hold together."""

    corridor: Corridor
    """The polytopes; its joints are the deepest points of their overlaps."""
    overlaps: Float[Array, "joints"]
    """Radius in metres of the widest ball in each overlap; negative where two polytopes do not meet."""
    left: Int[Array, "polytopes"]
    """Points that each polytope failed to cut away; all zero when the corridor may be used."""


def chain(
    method: Decomposition,
    waypoints: Float[Array, "vertices 3"],
    points: Float[Array, "points 3"],
    present: Bool[Array, "points"],
    radius: ScalarLike,
    clearance: ScalarLike = 0.1,
    limits: tuple[Vector3, Vector3] | None = None,
) -> Chain:
    """Corridor about a known route: pure, so ``jit`` compiles it and ``vmap`` runs it over many maps at once.

    Args:
        method: how to make a polytope.
        waypoints: (vertices, 3) the route, metres.
        points: (points, 3) obstacle points, metres, padded to one size for all maps.
        present: (points,) False where a row only pads.
        radius: safety radius, with the spread of a thinned cloud added, metres.
        clearance: radius to leave free around every leg where the points allow it, metres.
        limits: lower and upper corner of the volume the vehicle's centre may use, (3,) each, metres; None: no limit.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.corridor import EllipsoidDecomposition
        >>> maps = jnp.array([[[3.0, 1.0, 1.0]], [[3.0, -1.0, 1.0]]])
        >>> way = jnp.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [4.0, 5.0, 1.0]])
        >>> def through(points):
        ...     return chain(EllipsoidDecomposition(), way, points, jnp.array([True]), 0.3)
        >>> chains = jax.vmap(through)(maps)
        >>> chains.corridor.normals.shape, bool((chains.overlaps > 0.1).all())
        ((2, 2, 36, 3), True)
    """
    segments = jnp.stack([waypoints[:-1], waypoints[1:]], axis=1)
    lower, upper = (None, None) if limits is None else limits
    cells = jax.vmap(lambda segment: method(segment, points, present, radius, clearance, lower, upper))(
        segments
    )
    balls = consecutive_overlaps(cells.polytope)
    corridor = Corridor(cells.polytope.normals, cells.polytope.offsets, balls.centre)
    return Chain(corridor, balls.radius, cells.left)


def consecutive_overlaps(polytopes: Polytope) -> Ball:
    """Widest ball in the overlap of each polytope with the next; batched along axis 0."""
    before = jax.tree.map(lambda rows: rows[:-1], polytopes)
    after = jax.tree.map(lambda rows: rows[1:], polytopes)
    return overlap_balls(before, after)


@jax.jit
def _cells_one_by_one(method, legs, keep) -> Cell:
    """A loop over segments. On a CPU it is faster than all at once: each ends when its own points do."""

    def one(leg):
        segment, columns, present = leg
        return method(segment, columns.T, present, *keep)

    return jax.lax.map(one, legs)


@jax.jit
def _cells_at_once(method, legs, keep) -> Cell:
    """All segments at once, as a GPU is fastest."""

    def one(segment, columns, present):
        return method(segment, columns.T, present, *keep)

    return jax.vmap(one)(*legs)


@jax.jit
def _frames(segments) -> Seed:
    """Frames of many segments, along a leading axis."""
    return jax.vmap(seed_of)(segments)


def cells_along(
    method: Decomposition,
    segments: Float[np.ndarray, "segments 2 3"],
    cloud: PointCloud,
    radius: float,
    clearance: float = 0.1,
    lower: Float[np.ndarray, "3"] | None = None,
    upper: Float[np.ndarray, "3"] | None = None,
) -> Cell:
    """One cell a segment, from the host: each is given only the points near it.

    Points are cut to each segment's box and padded to one of few sizes. Segments are run a few at a time, so that few
    shapes are ever compiled. The cells come back as NumPy arrays along a leading axis.

    Args:
        method: how to make a polytope.
        segments: (segments, 2, 3) ends, metres.
        cloud: obstacles; its spread is added to the radius.
        radius: safety radius of the vehicle, metres.
        clearance: radius to leave free around every segment where the points allow it, metres.
        lower: (3,) lower corner of the volume the vehicle's centre may use, metres; None: no limit.
        upper: (3,) its upper corner, metres; None: no limit.
    """
    keep = radius + cloud.spread
    columns = np.ascontiguousarray(cloud.points.T)
    # Padded to whole calls, so that few numbers of segments are ever compiled.
    padded = np.resize(segments, (len(segments) + -len(segments) % _LEGS_A_CALL, 2, 3))
    frames = jax.device_get(_frames(padded))
    boxes = zip(frames.axes, frames.middle, frames.half, strict=True)
    near = [_near(columns, *box, method.reach + keep) for box in islice(boxes, len(segments))]
    # Segments with like numbers of points go together, so that little is padded.
    order = np.argsort([points.shape[1] for points in near], kind="stable")
    run = _cells_one_by_one if jax.default_backend() == "cpu" else _cells_at_once
    low = np.full(3, -np.inf) if lower is None else np.asarray(lower, float)
    high = np.full(3, np.inf) if upper is None else np.asarray(upper, float)
    calls = []
    for first in range(0, len(order), _LEGS_A_CALL):
        some = order[first : first + _LEGS_A_CALL]
        bucket = _bucket(near[some[-1]].shape[1])
        points = np.zeros((_LEGS_A_CALL, 3, bucket))
        present = np.zeros((_LEGS_A_CALL, bucket), bool)
        ends = np.zeros((_LEGS_A_CALL, 2, 3))
        for row, index in enumerate(some):
            count = near[index].shape[1]
            ends[row] = segments[index]
            points[row, :, :count] = near[index]
            present[row, :count] = True
        calls.append(run(method, (ends, points, present), (keep, clearance, low, high)))
    back = np.argsort(order)
    return jax.tree.map(lambda *rows: np.concatenate(rows)[back], *jax.device_get(calls))


def _bucket(count: int) -> int:
    """The size that so many points are padded to."""
    size = _SMALLEST_BUCKET
    while size < count:
        size *= 4
    return size


def _near(
    columns: Float[np.ndarray, "3 points"],
    axes: Float[np.ndarray, "3 3"],
    middle: Float[np.ndarray, "3"],
    half: float,
    reach: float,
) -> Float[np.ndarray, "3 near"]:
    """Points in a segment's box, and a little around it, so that the device's rounding misses none."""
    extent = np.array([half, 0.0, 0.0]) + (reach + _MARGIN)
    around = extent @ np.abs(axes)
    low, high = middle - around, middle + around
    inside = (columns[0] >= low[0]) & (columns[0] <= high[0])
    for axis in (1, 2):
        inside &= columns[axis] >= low[axis]
        inside &= columns[axis] <= high[axis]
    points = columns.take(np.flatnonzero(inside), axis=1)
    local = np.abs(axes @ (points - middle[:, None]))
    return points.take(np.flatnonzero(np.all(local <= extent[:, None], axis=0)), axis=1)
