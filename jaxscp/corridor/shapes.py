"""What a polytope looks like from the host: its corners, its volume, the faces that matter."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from jaxscp.corridor.overlaps import deepest_ball
from jaxscp.corridor.polytopes import Polytope

_ROOM = 1e-3
_LEAST = 1e-9

Vertices = Float[np.ndarray, "vertices 3"]


def _intersection(
    polytope: Polytope, hint: ArrayLike | None
) -> tuple[HalfspaceIntersection, Int[np.ndarray, "used"]] | None:
    """Qhull's intersection and the rows it was given; None where the polytope has no inside."""
    normals, offsets = np.asarray(polytope.normals, float), np.asarray(polytope.offsets, float)
    used = np.flatnonzero(np.any(normals != 0, axis=1))
    inside = _inside(polytope, normals[used], offsets[used], hint)
    if inside is None:
        return None
    try:
        return HalfspaceIntersection(
            np.concatenate([normals[used], -offsets[used, None]], axis=1), inside
        ), used
    except QhullError:
        return None


def _inside(polytope: Polytope, normals, offsets, hint: ArrayLike | None) -> Float[np.ndarray, "3"] | None:
    """A point with some room about it: the hint if it has that, else the deepest."""
    if hint is not None:
        point = np.asarray(hint, float)
        if np.min(offsets - normals @ point) > _ROOM:
            return point
    ball = deepest_ball(polytope)
    return np.asarray(ball.centre, float) if float(ball.radius) > _LEAST else None


def vertices(polytope: Polytope) -> Vertices:
    """Corners of a bounded polytope in metres, (vertices, 3); none where it has no inside.

    Example:
        >>> import jaxscp
        >>> vertices(jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])).max(axis=0).tolist()
        [1.0, 2.0, 3.0]
    """
    found = _intersection(polytope, None)
    if found is None:
        return np.empty((0, 3))
    corners = found[0].intersections
    return corners[np.isfinite(corners).all(axis=1)]


def volume(polytope: Polytope) -> float:
    """Volume of a bounded polytope in cubic metres.

    Example:
        >>> import jaxscp
        >>> round(volume(jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])), 9)
        6.0
    """
    corners = vertices(polytope)
    return float(ConvexHull(corners).volume) if len(corners) else 0.0


def needed_faces(polytope: Polytope, hint: ArrayLike | None = None) -> Int[np.ndarray, "needed"]:
    """Rows that are faces of the polytope: without the others it is the same set.

    Args:
        polytope: the polytope; one without an inside needs all its rows.
        hint: (3,) a point that is likely well inside, metres; it saves looking for one.

    Example:
        >>> import jaxscp
        >>> from jaxscp.corridor.overlaps import intersect
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])
        >>> larger = jaxscp.corridor.box([-1.0, -1.0, -1.0], [4.0, 4.0, 4.0])
        >>> needed_faces(intersect(room, larger)).tolist()
        [0, 1, 2, 3, 4, 5]
    """
    found = _intersection(polytope, hint)
    if found is None:
        return np.flatnonzero(np.any(np.asarray(polytope.normals) != 0, axis=1))
    intersection, used = found
    return np.sort(used[np.asarray(intersection.dual_vertices)])
