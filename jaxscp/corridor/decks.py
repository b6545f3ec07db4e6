"""Decks: points that start or goal stands on, which are obstacles for every leg but the one from there.

A deck frees no space behind it. On the leg from a deck, the vehicle's centre never comes nearer to its points
than at the end itself. It never goes beyond the end towards the deck.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxscp.core.arrays import unit_lengths
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.limits import Limits, Point
from jaxscp.corridor.polytope import Polytope

_LEVEL = 1e-6
_SLACK = 1e-3
_DECISIVE = 0.2


class Deck(eqx.Module):
    """Points of a cloud that the leg from one end need not keep the radius from."""

    freed: Bool[np.ndarray, "points"]
    """Points that do not count as obstacles on that leg."""
    support: Bool[np.ndarray, "points"]
    """Freed points on the deck's side, from which the leg keeps the distance ``keep``."""
    keep: float
    """Distance of the end from its deck, metres."""
    axis: int
    """Axis along which the deck lies: 0, 1 or 2."""
    sign: float
    """The deck's side on that axis: -1 for a deck below along z."""

    def chosen(self, rows: Bool[np.ndarray, "all"]) -> "Deck":
        """The deck in a cloud of which a mask chooses the points."""
        return Deck(self.freed[rows], self.support[rows], self.keep, self.axis, self.sign)

    def limits(self, limits: Limits, end: Point) -> Limits:
        """Limits that end at the deck: the centre does not go beyond the end towards it."""
        lower, upper = limits.lower.copy(), limits.upper.copy()
        bound = float(end[self.axis]) + self.sign * _SLACK
        if self.sign < 0:
            lower[self.axis] = max(lower[self.axis], bound)
        else:
            upper[self.axis] = min(upper[self.axis], bound)
        return Limits(lower, upper)

    def towards(self) -> Float[np.ndarray, "3"]:
        """Direction of the deck from the end."""
        direction = np.zeros(3)
        direction[self.axis] = self.sign
        return direction


def obstacles_of_leg(
    cloud: PointCloud, decks: Sequence[Deck], nearest: Float[np.ndarray, "points 3"], radius: float
) -> PointCloud:
    """Obstacles of the leg from a deck: its points are moved off, so that ``radius`` from there is ``keep`` here.

    Args:
        cloud: the obstacles.
        decks: decks that the leg begins or ends on.
        nearest: (points, 3) point of the leg that is nearest to each obstacle, metres.
        radius: safety radius of the vehicle, metres.
    """
    points, counts = cloud.points.copy(), np.ones(cloud.count, bool)
    for deck in decks:
        off = cloud.points[deck.support] - nearest[deck.support]
        lengths = np.linalg.norm(off, axis=1)[:, None]
        direction = np.where(lengths > _LEVEL, off / np.maximum(lengths, _LEVEL), deck.towards())
        points[deck.support] += (radius + cloud.spread - deck.keep) * direction
        counts &= deck.support | ~deck.freed
    return PointCloud(points, cloud.spread, cloud.dropped, cloud.provenance).chosen(counts)


def split_decks(
    cloud: PointCloud,
    regions: Sequence[Polytope],
    ends: tuple[Point, Point],
    radius: float,
    voxel: float | None,
) -> tuple[PointCloud, tuple[Deck | None, Deck | None]]:
    """The thinned cloud, and the decks of start and goal in it.

    Points in a region that holds neither end are removed. A region that holds an end is its deck. The cloud is thinned
    by voxels of an edge, where one is given.

    Example:
        >>> from jaxscp.corridor.polytope import box
        >>> floor = PointCloud.of([[x, y, 0.0] for x in np.arange(-1, 1, 0.1) for y in np.arange(-1, 1, 0.1)])
        >>> start, goal = np.array([0.0, 0.0, 0.1]), np.array([5.0, 0.0, 1.0])
        >>> _, (deck, none) = split_decks(floor, [box(start - 0.5, start + 0.5)], (start, goal), 0.25, None)
        >>> round(deck.keep, 3), deck.axis, deck.sign, none is None
        (0.1, 2, -1.0, True)
    """
    holders = [[holds(region, end) for end in ends] for region in regions]
    cropped = np.zeros(cloud.count, bool)
    removed = np.zeros(cloud.count, bool)
    for region, held in zip(regions, holders, strict=True):
        (cropped if any(held) else removed)[cloud.inside(region)] = True
    cropped &= ~removed
    # Thinned one by one, so that no point stands for others across a region's border.
    parts = [cloud.chosen(~cropped & ~removed), cloud.chosen(cropped)]
    if voxel is not None:
        parts = [part.thinned(voxel) for part in parts]
    firm, freed = parts
    if not freed.count:
        return firm, (None, None)
    spread = max(firm.spread, freed.spread)
    points = np.concatenate([firm.points, freed.points])
    both = PointCloud(points, spread, cloud.dropped, cloud.provenance)
    decks = []
    for k, end in enumerate(ends):
        own = [region for region, held in zip(regions, holders, strict=True) if held[k]]
        rows = np.any(
            [both.inside(region, margin=_LEVEL) for region in own] or [np.zeros(both.count, bool)], axis=0
        )
        rows[: firm.count] = False
        decks.append(_deck(both, rows, end, radius))
    return both, (decks[0], decks[1])


def holds(region: Polytope, point: Point) -> bool:
    """Whether a region holds a point.

    Example:
        >>> from jaxscp.corridor.polytope import box
        >>> holds(box([0, 0, 0], [1, 1, 1]), np.array([0.5, 0.5, 1.0]))
        True
    """
    normals = np.asarray(region.normals)
    return bool(np.all(normals @ point <= np.asarray(region.offsets) + _LEVEL * unit_lengths(normals)))


def _deck(cloud: PointCloud, own: Bool[np.ndarray, "points"], end: Point, radius: float) -> Deck | None:
    """The deck of one end; None where the end keeps the radius from its points anyway."""
    off = cloud.points - end
    distance = np.linalg.norm(off, axis=1)
    tight = own & (distance < radius + cloud.spread)
    if not tight.any():
        return None
    middle = off[tight].mean(axis=0)
    decisive = np.linalg.norm(middle) > _DECISIVE * distance[tight].mean()
    axis = int(np.argmax(np.abs(middle))) if decisive else 2
    sign = float(np.sign(middle[axis])) if decisive else -1.0
    support = own & (sign * off[:, axis] >= -_LEVEL)
    keep = float(distance[support].min(initial=radius + cloud.spread))
    # Points on the other side and within the radius are of the vehicle itself, or it could not be here.
    return Deck(support | tight, support, keep, axis, sign or -1.0)
