"""Obstacles and limits of a route search, and distances from them."""

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decks import Deck
from jaxscp.corridor.extent import within
from jaxscp.corridor.limits import Limits, Point

Places = Float[np.ndarray, "*batch 3"]
Distances = Float[np.ndarray, "*batch"]


class Space(eqx.Module):
    """Obstacles, and how near the vehicle may come."""

    points: Float[np.ndarray, "points 3"]
    tree: "scipy.spatial.KDTree | None"
    lower: Point
    upper: Point
    radius: float
    """Distance to keep from every point: the safety radius and the spread of the cloud, metres."""
    roomy: float
    """Distance to keep between the ends: the clearance is added, metres."""
    decks: tuple[Deck | None, Deck | None] = (None, None)
    """Decks that start and goal stand on."""

    def to_points(self, places: Places) -> Distances:
        """Distance from each place to the nearest obstacle point, metres; inf where there is none."""
        if self.tree is None:
            return np.full(places.shape[:-1], np.inf)
        return np.asarray(self.tree.query(places)[0])

    def to_limits(self, places: Places) -> Distances:
        """Distance to the limits as if they were points: their clearance is kept, their radius is in them."""
        return self.radius + np.minimum(places - self.lower, self.upper - places).min(axis=-1)

    def distance(self, places: Places) -> Distances:
        """Distance from each place to the nearest of points and limits, metres."""
        return np.minimum(self.to_points(places), self.to_limits(places))

    def along(self, start: Point, end: Point) -> float:
        """Distance from a segment to points and limits, capped at the roomy distance, metres."""
        return self._along(self.points, start, end)

    def to_segment(self, start: Point, end: Point) -> float:
        """Distance from a segment to the nearest obstacle point, metres; inf where there is none."""
        reach = float(self.to_points(0.5 * (start + end)))
        if not np.isfinite(reach):
            return reach
        # No farther than from its middle.
        low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
        return segment_distance(self.points[within(self.points, low, high)], start, end)

    def _along(self, points: Float[np.ndarray, "points 3"], start: Point, end: Point) -> float:
        low, high = np.minimum(start, end) - self.roomy, np.maximum(start, end) + self.roomy
        near = np.flatnonzero((points[:, 0] >= low[0]) & (points[:, 0] <= high[0]))
        for axis in (1, 2):
            column = points[near, axis]
            near = near[(column >= low[axis]) & (column <= high[axis])]
        limits = float(self.to_limits(np.stack([start, end])).min())
        return min(self.roomy, limits, segment_distance(points[near], start, end))

    def from_end(self, end: int, place: Point, far: Point) -> float:
        """Like ``along`` for a leg from start (0) or goal (1): its deck does not count if it keeps off it."""
        deck = self.decks[end]
        if deck is None:
            return self.along(place, far)
        if segment_distance(self.points[deck.support], place, far) < deck.keep - 1e-9:
            return 0.0
        return self._along(self.points[~deck.freed], place, far)

    def at_end(self, end: int, place: Point) -> float:
        """Distance from start (0) or goal (1) to the nearest point that is not of its deck, metres."""
        deck = self.decks[end]
        if deck is None:
            return float(self.to_points(place[None])[0])
        return segment_distance(self.points[~deck.freed], place, place)


def search_space(
    cloud: PointCloud,
    limits: Limits,
    radius: float,
    clearance: float,
    decks: tuple[Deck | None, Deck | None],
) -> Space:
    """Space of a search within limits; points that are too far outside are left out."""
    keep = radius + cloud.spread
    reach = keep + clearance
    near = within(cloud.points, limits.lower - reach, limits.upper + reach)
    points = cloud.points[near]
    tree = scipy.spatial.KDTree(points) if points.size else None
    left = (None if deck is None else deck.chosen(near) for deck in decks)
    return Space(points, tree, *limits, keep, reach, tuple(left))  # pyright: ignore[reportArgumentType]


def segment_distance(points: Float[np.ndarray, "points 3"], start: Point, end: Point) -> float:
    """Distance from a segment to the nearest of some points, metres; inf where there is none.

    Example:
        >>> segment_distance(np.array([[1.0, 2.0, 0.0]]), np.zeros(3), np.array([4.0, 0.0, 0.0]))
        2.0
    """
    if points.shape[0] == 0:
        return float("inf")
    off = points - nearest_on_segment(points, start, end)
    return float(np.sqrt(np.min(np.sum(off**2, axis=1))))


def nearest_on_segment(
    points: Float[np.ndarray, "points 3"], start: Point, end: Point
) -> Float[np.ndarray, "points 3"]:
    """Point of a segment that is nearest to each point, metres.

    Example:
        >>> nearest_on_segment(np.array([[1.0, 2.0, 0.0]]), np.zeros(3), np.array([4.0, 0.0, 0.0])).tolist()
        [[1.0, 0.0, 0.0]]
    """
    along = end - start
    length2 = float(along @ along)
    fraction = np.clip((points - start) @ along / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(points))
    return start + fraction[:, None] * along
