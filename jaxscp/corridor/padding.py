"""Corridors of a given size, so that they batch."""

import jax.numpy as jnp
from numpy.typing import ArrayLike

from jaxscp.core.arrays import namespace
from jaxscp.corridor.polytopes import Corridor


def pad(
    corridor: Corridor, goal: ArrayLike, polytopes: int | None = None, faces: int | None = None
) -> Corridor:
    """A corridor of a given size: the last polytope repeated with the goal as joint, rows 0 . p <= 1 added.

    Args:
        corridor: the corridor to pad.
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
    xp = namespace(corridor, goal)  # known numbers compile nothing
    more = polytopes - count
    normals = xp.pad(corridor.normals, ((0, 0), (0, faces - rows), (0, 0)))
    offsets = xp.pad(corridor.offsets, ((0, 0), (0, faces - rows)), constant_values=1.0)
    last = xp.broadcast_to(xp.asarray(goal, offsets.dtype), (more, 3))
    parts = (
        xp.concatenate([normals, xp.repeat(normals[-1:], more, axis=0)]),
        xp.concatenate([offsets, xp.repeat(offsets[-1:], more, axis=0)]),
        xp.concatenate([xp.asarray(corridor.joints), last]),
    )
    normals, offsets, joints = map(jnp.asarray, parts)
    return Corridor(normals, offsets, joints, corridor.margin)
