"""Half-spaces that separate points from a seed segment, the nearest point of a metric first."""

# pyright: reportArgumentType=false, reportOperatorIssue=false
# jax 0.9 declares of ``where`` that it may return a tuple, for arguments whose types are not declared

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from jaxscp.core.types import Vector3
from jaxscp.corridor.ellipsoids import Columns, Ellipsoid, first_index_of_least

Rule = Callable[[Vector3, Vector3, Vector3, ScalarLike, ScalarLike], Vector3]
"""Chooses a plane's normal from (tangent, capsule normal, point, half length, distance to leave the seed)."""

_TURNS = 32


class Cuts(eqx.Module):
    """Half-spaces in K slots, and how many points they failed to cut away."""

    normals: Float[Array, "faces 3"]
    """Outward unit normals; zero in unused slots."""
    offsets: Float[Array, "faces"]
    """Signed distances from the origin in metres; one in unused slots."""
    left: Int[Array, ""]
    """Points still inside when the slots ran out."""


def unit(vector: Vector3) -> Vector3:
    """The direction of a vector; zero stays zero."""
    length = jnp.linalg.norm(vector)
    return vector / jnp.where(length > 0, length, 1.0)


def seed_gap(normal: Vector3, point: Vector3, half: ScalarLike) -> Float[Array, ""]:
    """Distance in metres from the plane through a point to the segment ``|x| <= half`` on the x axis."""
    return normal @ point - half * jnp.abs(normal[0])


def capsule_normal(point: Vector3, half: ScalarLike) -> Vector3:
    """Normal of the plane that leaves the segment the widest gap: from its closest point to the obstacle point."""
    nearest = jnp.clip(point[0], jnp.negative(half), half)
    return unit(point - jnp.array([1.0, 0.0, 0.0], point.dtype) * nearest)


def switch(tangent: Vector3, capsule: Vector3, point: Vector3, half: ScalarLike, need: ScalarLike) -> Vector3:
    """The tangent normal where it leaves the seed enough distance, else the capsule's."""
    return jnp.where(seed_gap(tangent, point, half) >= need, tangent, capsule)


def turn(tangent: Vector3, capsule: Vector3, point: Vector3, half: ScalarLike, need: ScalarLike) -> Vector3:
    """The first normal, on the way from the tangent's to the capsule's, that leaves the seed enough distance.

    Normals that leave it make a convex cone, which the capsule's normal lies in whenever any does: so the way
    enters it once. This stands for the small quadratic program of restrictive inflation (Wang et al. 2024,
    section IV), with a gap to the seed that is not zero.
    """
    fraction = jnp.linspace(0.0, 1.0, _TURNS + 1, dtype=point.dtype)[:, None]
    ways = (1.0 - fraction) * tangent + fraction * capsule
    gaps = ways @ point - half * jnp.abs(ways[:, 0])
    fits = gaps >= jnp.asarray(need) * jnp.sqrt(jnp.sum(ways * ways, axis=1))
    return unit(ways[jnp.where(jnp.any(fits), jnp.argmax(fits), _TURNS)])


def capsule_only(
    tangent: Vector3, capsule: Vector3, point: Vector3, half: ScalarLike, need: ScalarLike
) -> Vector3:
    """The capsule's normal always: less volume, fewer faces, wider overlaps."""
    return capsule


class Keep(NamedTuple):
    """Distances that a plane keeps."""

    radius: ScalarLike
    """From every point, metres."""
    clearance: ScalarLike
    """Around the seed where the points allow it, metres."""


def cut_away(
    points: Columns,
    active: Bool[Array, "points"],
    metric: Ellipsoid,
    half: ScalarLike,
    keep: Keep,
    planes: int,
    rule: Rule,
) -> Cuts:
    """Half-spaces that cut points away one plane at a time, until none is left or the slots are full.

    Each plane passes through the point that a growing copy of the ellipsoid meets first. It is tangent to that copy
    there unless the rule says otherwise, and takes every point behind it away. Then it is moved ``radius`` towards
    the seed: all these points stay ``radius`` or more from the rest (Liu et al. 2017, section III-B).

    Args:
        points: (3, points) in the seed's frame: the segment ``|x| <= half`` on the x axis, metres.
        active: (points,) which of them count.
        metric: the ellipsoid that grows.
        half: half the seed's length, metres.
        keep: distances to keep.
        planes: slots.
        rule: how to choose a normal when the tangent plane comes too near the seed.
    """
    to_ball = jnp.linalg.inv(metric.shape)
    in_ball = to_ball @ (points - metric.centre[:, None])
    growth = jnp.where(active, jnp.sum(in_ball * in_ball, axis=0), jnp.inf)
    # Copies of one point must all go with its plane, whatever the last bit of their products says.
    slack = 16.0 * jnp.finfo(points.dtype).eps * (1.0 + jnp.max(jnp.abs(jnp.where(active, points, 0.0))))

    def unfinished(state):
        slot, _, least, _, _, _ = state
        return (slot < planes) & jnp.isfinite(least)

    def cut(state):
        slot, growth, _, nearest, normals, offsets = state
        point = points[:, nearest]
        tangent = unit(to_ball.T @ in_ball[:, nearest])
        normal = rule(tangent, capsule_normal(point, half), point, half, keep.radius + keep.clearance)
        height = normal @ point
        along = normal[0] * points[0] + normal[1] * points[1] + normal[2] * points[2]
        growth = jnp.where(along < height - slack, growth, jnp.inf)
        normals, offsets = normals.at[slot].set(normal), offsets.at[slot].set(height - keep.radius)
        return (slot + 1, growth, *first_index_of_least(growth), normals, offsets)

    normals, offsets = jnp.zeros((planes, 3), points.dtype), jnp.ones(planes, points.dtype)
    state = (jnp.zeros((), jnp.int32), growth, *first_index_of_least(growth), normals, offsets)
    _, growth, _, _, normals, offsets = jax.lax.while_loop(unfinished, cut, state)
    return Cuts(normals, offsets, jnp.sum(jnp.isfinite(growth), dtype=jnp.int32))
