"""Obstacle points near a corridor, and those inside a corridor made by hand."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike

from jaxscp.core.arrays import floats
from jaxscp.core.obstacles import Hull as Hull  # a public name of this room
from jaxscp.core.obstacles import Obstacles
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.extent import within
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.shapes import vertices

_SMALLEST = 64


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
    inside = np.zeros(cloud.count, bool)
    for cell in corridor.distinct():
        near = np.flatnonzero(_in_box(cell, cloud, margin))
        inside[near] |= PointCloud(cloud.points[near]).inside(cell, margin)
    return inside


def obstacles_near(
    corridor: Corridor,
    cloud: PointCloud | ArrayLike,
    radius: float,
    *,
    decks: Sequence[Polytope] = (),
    size: int | None = None,
) -> Obstacles:
    """Points of a cloud within a distance of a corridor, padded to a static size.

    Args:
        corridor: polytopes for the vehicle's centre.
        cloud: obstacles, or their positions as an array, (points, 3), metres.
        radius: distance from the polytopes, metres, the vehicle's radius at least; the cloud's spread is added.
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
    cloud = PointCloud.at(cloud)
    on_deck = np.zeros(cloud.count, bool)
    for region in decks:
        on_deck |= cloud.inside(region)
    return padded_obstacles(corridor, cloud, radius, on_deck, size)


def padded_obstacles(
    corridor: Corridor,
    cloud: PointCloud,
    radius: float,
    on_deck: Bool[np.ndarray, "points"],
    size: int | None = None,
) -> Obstacles:
    """``obstacles_near``, with a mask of the points of decks."""
    rows = inside_corridor(corridor, cloud, radius + cloud.spread)
    count = int(np.count_nonzero(rows))
    size = size or max(_SMALLEST, 1 << max(count - 1, 0).bit_length())
    if count > size:
        raise ValueError(
            f"{count} obstacle points are near the corridor, more than size={size}; thin the cloud"
        )
    points, deck = np.zeros((size, 3)), np.zeros(size, bool)
    points[:count], deck[:count] = cloud.points[rows], on_deck[rows]
    masks = jnp.asarray(np.arange(size) < count), jnp.asarray(deck)
    return Obstacles(jnp.asarray(points), *masks, floats(cloud.spread), floats(radius))


def _in_box(cell: Polytope, cloud: PointCloud, margin: float) -> Bool[np.ndarray, "points"]:
    """Points in the box about a polytope; all points where it has no bounds."""
    corners = vertices(cell)
    if not len(corners):
        return np.ones(cloud.count, bool)
    return within(cloud.points, corners.min(axis=0) - margin, corners.max(axis=0) + margin)
