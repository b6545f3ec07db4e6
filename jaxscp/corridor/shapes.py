"""Corners, volume and needed faces of a polytope, on the host."""

import numpy as np
import scipy
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from jaxscp.corridor.polytope import Polytope

_INSIDE = 1e-3
_LEAST = 1e-9
_ON_FACE = 1e-7

Vertices = Float[np.ndarray, "vertices 3"]


def _intersection(
    polytope: Polytope, hint: ArrayLike | None
) -> "tuple[scipy.spatial.HalfspaceIntersection, Int[np.ndarray, 'used']] | None":
    """Qhull's intersection and the rows it was given; None where the polytope has no inside."""
    normals, offsets = np.asarray(polytope.normals, float), np.asarray(polytope.offsets, float)
    used = np.flatnonzero(np.any(normals != 0, axis=1))
    inside = _inside(normals[used], offsets[used], hint)
    if inside is None:
        return None
    try:
        return scipy.spatial.HalfspaceIntersection(
            np.concatenate([normals[used], -offsets[used, None]], axis=1), inside
        ), used
    except scipy.spatial.QhullError:
        return None


def _inside(normals, offsets, hint: ArrayLike | None) -> Float[np.ndarray, "3"] | None:
    """A point with some room about it: the hint if it has that, else the deepest.

    The deepest comes from SciPy's linear programming, not from ``overlaps``: on the host, every polytope may
    have another number of rows, and each would be compiled anew.
    """
    if hint is not None:
        point = np.asarray(hint, float)
        if np.min(offsets - normals @ point) > _INSIDE:
            return point
    rows = np.column_stack([normals, np.linalg.norm(normals, axis=1)])
    found = scipy.optimize.linprog([0.0, 0.0, 0.0, -1.0], rows, offsets, bounds=[(None, None)] * 4)
    return found.x[:3] if found.success and found.x[3] > _LEAST else None


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
    return float(scipy.spatial.ConvexHull(corners).volume) if len(corners) else 0.0


def inscribed_radius(polytope: Polytope) -> float:
    """Radius in metres of the widest ball in a bounded polytope; zero where the polytope is empty.

    Example:
        >>> import jaxscp
        >>> round(inscribed_radius(jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0])), 9)
        0.5
    """
    normals, offsets = np.asarray(polytope.normals, float), np.asarray(polytope.offsets, float)
    deepest = _inside(normals, offsets, None)
    if deepest is None:
        return 0.0
    lengths = np.linalg.norm(normals, axis=1)
    used = lengths > 0
    return float(np.min((offsets - normals @ deepest)[used] / lengths[used]))


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
    # Where more than three faces meet, a facet of the dual is no triangle, and they come as a ragged list.
    return used[np.unique(np.concatenate([np.asarray(facet) for facet in intersection.dual_facets]))]


def polygons(polytope: Polytope) -> list[Vertices]:
    """Faces of a bounded polytope as polygons, their corners in order round each, metres.

    Example:
        >>> import jaxscp
        >>> [len(face) for face in polygons(jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]))]
        [4, 4, 4, 4, 4, 4]
    """
    corners = vertices(polytope)
    faces = []
    for normal, offset in zip(np.asarray(polytope.normals), np.asarray(polytope.offsets), strict=True):
        if not np.any(normal):
            continue
        on_face = corners[np.abs(corners @ normal - offset) < _ON_FACE]
        if len(on_face) >= 3:
            faces.append(_in_order(on_face, normal))
    return faces


def _in_order(corners: Vertices, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "distinct 3"]:
    """Corners sorted by angle about their middle, copies left out."""
    from_middle = corners - corners.mean(axis=0)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    angle = np.arctan2(from_middle @ np.cross(normal, first), from_middle @ first)
    ordered = corners[np.argsort(angle)]
    distinct = np.linalg.norm(ordered - np.roll(ordered, 1, axis=0), axis=1) > _ON_FACE
    return ordered[distinct]
