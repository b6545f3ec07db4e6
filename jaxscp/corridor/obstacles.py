"""Obstacle points near a corridor, and those inside a corridor made by hand."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.extent import within
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.shapes import vertices

_SMALLEST = 64


class Obstacles(eqx.Module):
    """Obstacle points near a corridor, padded to a static size."""

    points: Float[Array, "points 3"]
    """Positions, (points, 3), metres; zero in rows that pad."""
    present: Bool[Array, "points"]
    """False in rows that pad, (points,)."""
    deck: Bool[Array, "points"]
    """Points of a deck, which count except in the first and the last leg, (points,)."""


def inside_corridor(corridor: Corridor, cloud: PointCloud, margin: float = 0.0) -> Bool[np.ndarray, "points"]:
    """Which points of a cloud lie in a polytope of a corridor, each grown by a margin.

    Args:
        corridor: polytopes for the vehicle's centre.
        cloud: obstacles.
        margin: distance that every face is moved outwards, metres. All points nearer than that to a polytope are found,
            and a few more at its corners.

    Example:
        >>> import jaxscp
        >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [4, 2, 3])])
        >>> cloud = PointCloud.of([[1.0, 1.0, 1.0], [4.2, 1.0, 1.0], [9.0, 9.0, 9.0]])
        >>> inside_corridor(room, cloud).tolist(), inside_corridor(room, cloud, margin=0.25).tolist()
        ([True, False, False], [True, True, False])
    """
    cells = corridor.distinct()
    near = np.flatnonzero(_in_box(cells, cloud, margin))
    candidates = PointCloud(cloud.points[near])
    inside = np.zeros(cloud.count, bool)
    for cell in cells:
        inside[near] |= candidates.inside(cell, margin)
    return inside


def obstacles_near(
    corridor: Corridor,
    cloud: PointCloud,
    radius: float,
    *,
    decks: Sequence[Polytope] = (),
    size: int | None = None,
) -> Obstacles:
    """Points of a cloud within a distance of a corridor, padded to a static size.

    Args:
        corridor: polytopes for the vehicle's centre.
        cloud: obstacles.
        radius: distance from the polytopes, metres; the cloud's spread is added.
        decks: regions of the decks that start and goal stand on.
        size: number of rows; None takes the next power of two, 64 at least.

    Raises:
        ValueError: more points are near than ``size``.

    Example:
        >>> import jaxscp
        >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0, 0, 0], [4, 2, 3])])
        >>> near = obstacles_near(room, PointCloud.of([[4.2, 1.0, 1.0], [9.0, 9.0, 9.0]]), radius=0.25)
        >>> near.points.shape, int(near.present.sum())
        ((64, 3), 1)
    """
    near = cloud.chosen(inside_corridor(corridor, cloud, radius + cloud.spread))
    size = size or max(_SMALLEST, 1 << max(near.count - 1, 0).bit_length())
    if near.count > size:
        raise ValueError(
            f"{near.count} obstacle points are near the corridor, more than size={size}; thin the cloud"
        )
    points, deck = np.zeros((size, 3)), np.zeros(size, bool)
    points[: near.count] = near.points
    for region in decks:
        deck[: near.count] |= near.inside(region)
    return Obstacles(jnp.asarray(points), jnp.asarray(np.arange(size) < near.count), jnp.asarray(deck))


def _in_box(cells: list[Polytope], cloud: PointCloud, margin: float) -> Bool[np.ndarray, "points"]:
    """Points in the box about all polytopes; all points where one of them has no bounds."""
    corners = [vertices(cell) for cell in cells]
    if not all(len(c) for c in corners):
        return np.ones(cloud.count, bool)
    found = np.concatenate(corners)
    low, high = found.min(axis=0) - margin, found.max(axis=0) + margin
    return within(cloud.points, low, high)
