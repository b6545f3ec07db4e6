"""A safe flight corridor: convex polytopes, each overlapping the next (equation 20)."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from jaxscp.core.arrays import floats, is_number, namespace, unit_lengths
from jaxscp.core.types import Normals, Offsets, Scalar, Vector3
from jaxscp.corridor.overlaps import deepest_ball
from jaxscp.corridor.polytope import Polytope as Polytope
from jaxscp.corridor.polytope import box as box
from jaxscp.corridor.polytope import intersect

_TOUCHING = 1e-9
"""Distance of two polytopes, in metres, that counts as none."""


class Corridor(eqx.Module):
    """Connected convex polytopes {p : normals p <= offsets}, in flight order.

    Rows are padded to one face count with ``0 . p <= 1``, so that corridors of one shape batch under
    ``vmap``. ``joints[j]`` is a point common to polytopes j and j + 1: the corridor's own proof that it is
    connected, and the way the initial guess takes through it.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 2.0, 3.0])
        >>> hall = jaxscp.corridor.box([3.0, 0.0, 0.0], [9.0, 2.0, 3.0])
        >>> corridor = jaxscp.corridor.connect([room, hall], joints=[[3.5, 1.0, 1.5]])
        >>> float(corridor.clearance(jnp.array([3.5, 1.0, 1.0]))[0])
        0.5
    """

    normals: Normals
    """Outward unit normals, (polytopes, faces, 3); zero in unused rows."""
    offsets: Offsets
    """Signed distances of the faces from the origin in metres, (polytopes, faces); one in unused rows."""
    joints: Float[Array, "joints 3"]
    """One point in each consecutive overlap in metres, (polytopes - 1, 3)."""
    margin: Scalar | None = None
    """Metres by which ``connect`` moved every face inwards; None if by none."""

    @property
    def count(self) -> int:
        """Number of polytopes, K."""
        return self.normals.shape[-3]

    def clearance(self, point: Vector3) -> Float[Array, "polytopes"]:
        """Distance in metres from a point to the nearest face of each polytope; negative outside it."""
        distances = (self.offsets - self.normals @ point) / jnp.asarray(unit_lengths(self.normals))
        return jnp.min(distances, axis=-1)

    def distinct(self) -> list[Polytope]:
        """The polytopes, each once and in flight order: padding repeats the last one. Outside of ``jit`` only.

        Example:
            >>> import jaxscp
            >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [4, 2, 3])], joints=[])
            >>> len(jaxscp.corridor.pad(room, [1, 1, 1], polytopes=4).distinct())
            1
        """
        cells = zip(np.asarray(self.normals), np.asarray(self.offsets), strict=True)
        found = {(normals.tobytes(), offsets.tobytes()): (normals, offsets) for normals, offsets in cells}
        return [Polytope(*map(jnp.asarray, cell)) for cell in found.values()]

    def same(self, first: Int[Array, "*_"], second: Int[Array, "*_"]) -> Bool[Array, "*_"]:
        """Whether pairs of polytopes, given by number, have the same rows: padding repeats the last one.

        Example:
            >>> import jax.numpy as jnp, jaxscp
            >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [4, 2, 3])], joints=[])
            >>> padded = jaxscp.corridor.pad(room, [1, 1, 1], polytopes=3)
            >>> padded.same(jnp.arange(3), jnp.array(0)).tolist()
            [True, True, True]
        """
        normals = jnp.all(self.normals[first] == self.normals[second], axis=(-2, -1))
        return normals & jnp.all(self.offsets[first] == self.offsets[second], axis=-1)

    def with_unit_normals(self) -> "Corridor":
        """The same corridor with unit normals, so that offsets and violations are metres.

        Rows whose normals have unit length already stay as they are, bit by bit.

        Example:
            >>> import jaxscp
            >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [4, 2, 3])], joints=[])
            >>> scaled = Corridor(1e-4 * room.normals, 1e-4 * room.offsets, room.joints)
            >>> scaled.with_unit_normals().offsets.round(9).tolist()
            [[4.0, 2.0, 3.0, -0.0, -0.0, -0.0]]
        """
        normals, offsets = unit_rows(self.normals, self.offsets)
        return dataclasses.replace(self, normals=jnp.asarray(normals), offsets=jnp.asarray(offsets))


def connect(
    polytopes: Sequence[Polytope], joints: ArrayLike | None = None, *, margin: float = 0.0
) -> Corridor:
    """Chain polytopes into a corridor for the vehicle's centre, padded to one face count, with unit normals.

    A corridor bounds the centre. For polytopes that bound free space, give the vehicle's radius as margin.

    Args:
        polytopes: K polytopes in flight order.
        joints: (K - 1, 3) points, each inside two consecutive polytopes, in metres. None takes the centre of
            the largest ball in each overlap.
        margin: distance to move every face inwards, metres.

    Raises:
        ValueError: there is no polytope, the margin is negative, or the number of joints is wrong. Without joints
            also: a polytope is empty, or two consecutive ones do not overlap. The message has their numbers, from 0.

    Example:
        >>> import jaxscp
        >>> rooms = [jaxscp.corridor.box([0, 0, 0], [4, 2, 3]), jaxscp.corridor.box([3, 0, 0], [9, 2, 3])]
        >>> corridor = jaxscp.corridor.connect(rooms, margin=0.25)
        >>> corridor.joints.round(3).tolist(), corridor.offsets[0].round(3).tolist()
        ([[3.5, 1.0, 1.5]], [3.75, 1.75, 2.75, -0.25, -0.25, -0.25])
    """
    polytopes = _checked(polytopes)
    if not (is_number(margin) and margin >= 0):
        raise ValueError(f"connect: margin must be one number of metres, not negative, got {margin!r}")
    xp = namespace(polytopes, joints)
    faces = max(polytope.offsets.size for polytope in polytopes)
    pads = [faces - polytope.offsets.size for polytope in polytopes]
    padded = list(zip(polytopes, pads, strict=True))
    normals = xp.stack([xp.pad(p.normals, ((0, n), (0, 0))) for p, n in padded])
    offsets = xp.stack([xp.pad(p.offsets, (0, n), constant_values=1.0) for p, n in padded])
    normals, offsets = unit_rows(normals, offsets)
    if margin:
        offsets = xp.where(xp.any(normals != 0, axis=-1), offsets - margin, offsets)
    if joints is None:
        centres = _found_joints(normals, offsets, margin)
    else:
        centres = xp.asarray(joints, float).reshape(-1, 3)
        if len(centres) != len(polytopes) - 1:
            raise ValueError(
                f"connect: {len(polytopes)} polytopes need {len(polytopes) - 1} joints, one between each two, "
                f"got {len(centres)}"
            )
    moved = floats(margin) if margin else None
    return Corridor(jnp.asarray(normals), jnp.asarray(offsets), jnp.asarray(centres), moved)


def _checked(polytopes: Any) -> list[Polytope]:
    """The polytopes of a chain.

    Raises:
        ValueError: there is none, or one has no faces, or something else is in the list or in its place.
    """
    if isinstance(polytopes, Polytope):
        raise ValueError("connect: a list of polytopes is expected, got one polytope")
    found = list(polytopes)
    if not found:
        raise ValueError("connect: a corridor needs at least one polytope")
    for number, polytope in enumerate(found):
        if not isinstance(polytope, Polytope):
            raise ValueError(f"connect: element {number} is no polytope, but {polytope!r:.60}")
        if polytope.offsets.size == 0:
            raise ValueError(f"connect: polytope {number} has no faces")
    return found


def unit_rows(normals: Any, offsets: Any) -> tuple[Any, Any]:
    """Rows divided by the length of their normals, where that is neither zero nor one; NumPy's arrays if known.

    Args:
        normals: (..., faces, 3).
        offsets: (..., faces), m times the length of the normal.

    Example:
        >>> [rows.tolist() for rows in unit_rows(np.array([[0.0, 0.0, 2.0]]), np.array([3.0]))]
        [[[0.0, 0.0, 1.0]], [1.5]]
    """
    xp, lengths = namespace(normals, offsets), unit_lengths(normals)
    normals, offsets = xp.asarray(normals), xp.asarray(offsets)
    return normals / lengths[..., None], offsets / lengths


def _found_joints(normals: Any, offsets: Any, margin: float) -> Any:
    """Centres of the largest balls in consecutive overlaps; checked where they are known."""
    if len(offsets) == 1:
        return np.empty((0, 3))
    cells = jax.vmap(Polytope)(jnp.asarray(normals), jnp.asarray(offsets))
    pairs = jax.vmap(intersect)(
        jax.tree.map(lambda rows: rows[:-1], cells), jax.tree.map(lambda rows: rows[1:], cells)
    )
    balls = jax.vmap(deepest_ball)(pairs)
    if namespace(normals, offsets) is np and np.any(np.asarray(balls.radius) <= 0):
        inside = np.asarray(jax.vmap(deepest_ball)(cells).radius)
        after = f" once {margin:g} m of margin are taken off every face" if margin else ""
        for k in np.flatnonzero(inside <= 0):
            before = inside[k] + margin  # the radius shrinks with the margin
            cause = f"its faces leave a ball of radius {before:.3g} m; are its corners swapped?"
            if before > 0:
                cause = f"its widest ball has a radius of {before:.3g} m; is margin in metres?"
            raise ValueError(f"connect: polytope {k} is empty{after}: {cause}")
        k = int(np.argmax(np.asarray(balls.radius) <= 0))
        gap = -2 * float(balls.radius[k])
        found = f"they are {gap:.3g} m apart" if gap > _TOUCHING else "they only touch"
        least = f" An overlap must exceed twice the margin, {2 * margin:.3g} m." if margin > 0 else ""
        raise ValueError(
            f"connect: polytopes {k} and {k + 1} do not overlap{after}, so that there is no joint {k}: {found}; are "
            f"they in flight order?{least}"
        )
    return balls.centre
