"""A map of recent scans, in the frame of the vehicle's odometry. It lives on the host."""

import functools

import numpy as np
import scipy
from jaxtyping import Bool, Float

from jaxscp.corridor import PointCloud
from jaxscp.mission.attitudes import rotations

Points = Float[np.ndarray, "_ 3"]

_NEAREST = 0.5  # m: returns of leaves beside the vehicle; obstacles were seen from afar
# m; and returns, itself included, that make an obstacle nearer and farther than that
_NEAR, _MANY, _FEW = 4.0, 4, 3
_SPACING = 0.15, 0.05  # m, and m for each metre of distance: in which its neighbours lie


class Scan:
    """Points of one scan, in the frame of the odometry.

    Args:
        points: m.
        place: of the vehicle, m.
        denoise: whether single returns are dropped: leaves.
    """

    def __init__(self, points: Points, place: Float[np.ndarray, "3"], denoise: bool = False) -> None:
        self.returns = points[np.linalg.norm(points - place, axis=1) > _NEAREST]
        """All that count, leaves too."""
        self._place, self._denoise = place, denoise

    @functools.cached_property
    def points(self) -> Points:
        """The returns without those that are nearly alone: single leaves."""
        return self.returns[self._solid(self.returns)]

    @functools.cached_property
    def _tree(self) -> scipy.spatial.KDTree:
        return scipy.spatial.KDTree(self.returns, balanced_tree=False)

    def _solid(self, points: Points) -> Bool[np.ndarray, "_"]:
        """Which of these returns have enough neighbours."""
        if not self._denoise or not len(points):
            return np.ones(len(points), bool)
        distance = np.linalg.norm(points - self._place, axis=1)
        reach = _SPACING[0] + _SPACING[1] * distance
        away = self._tree.query(points, k=[_FEW, _MANY], distance_upper_bound=float(reach.max()) + 1e-9)[0]
        away = np.where(distance < _NEAR, away[:, 1], away[:, 0])  # of the last neighbour that is needed
        return away <= reach

    def blocks(self, way: Float[np.ndarray, "samples 3"], distance: float, floor: float) -> bool:
        """Whether a point higher than the floor is closer to the way than a distance, m.

        Args:
            way: m.
            distance: m.
            floor: m.
        """
        if not len(way):
            return False
        near = (self.returns > way.min(axis=0) - distance) & (self.returns < way.max(axis=0) + distance)
        returns = self.returns[near.all(axis=1) & (self.returns[:, 2] > floor)]
        away = scipy.spatial.KDTree(way).query(returns, distance_upper_bound=distance)[0]
        return bool(self._solid(returns[away < distance]).any())


class RecentMap:
    """Points of the scans of the last metres of the way.

    The odometry drifts with the distance: a point's position is as uncertain as the way since its scan. Older scans are
    dropped.

    Args:
        memory: m of the way after which a scan is forgotten.
        denoise: whether single returns are dropped: leaves.

    Example:
        >>> import numpy as np
        >>> recent = RecentMap(memory=10.0)
        >>> recent.add(np.array([[2.0, 0.0, 1.0]]), np.array([0.0, 0.0, 1.0]))
        >>> recent.cloud().count
        1
    """

    def __init__(self, memory: float, denoise: bool = False) -> None:
        self.memory, self.denoise = memory, denoise
        self._scans: list[tuple[float, Scan]] = []
        self._way, self._last = 0.0, None

    def add(self, points: Points, place: Float[np.ndarray, "3"]) -> None:
        """Add a scan.

        Args:
            points: in the frame of the odometry, m.
            place: of the vehicle, in that frame.
        """
        if self._last is not None:
            self._way += float(np.linalg.norm(place - self._last))
        self._last = place
        self._scans.append((self._way, Scan(points, place, self.denoise)))
        self._scans = [scan for scan in self._scans if self._way - scan[0] <= self.memory]

    def forget(self) -> None:
        """Drop all scans but the last: older ones have drifted, and leaves add up."""
        self._scans = self._scans[-1:]

    def cloud(self) -> PointCloud:
        """All points that are remembered."""
        parts = [scan.points for _, scan in self._scans]
        return PointCloud.of(np.concatenate(parts) if parts else np.zeros((0, 3)))

    def latest(self) -> Scan:
        """The last scan; one without points before the first."""
        return self._scans[-1][1] if self._scans else Scan(np.zeros((0, 3)), np.zeros(3))


def in_odometry_frame(
    ranges: Float[np.ndarray, "rays"], directions: Float[np.ndarray, "rays 3"], state: Float[np.ndarray, "13"]
) -> Points:
    """Points of a scan in the frame of the odometry, m; rays without return (zero) are left out.

    Args:
        ranges: m.
        directions: unit vectors, body axes.
        state: of the vehicle, estimated.
    """
    seen = ranges != 0.0
    points = ranges[seen, None] * directions[seen]
    return state[:3] + points @ rotations(state[6:10]).as_matrix().T


def clearance(points: Points, way: Float[np.ndarray, "samples 3"]) -> float:
    """Least distance in m between points and samples of a way; infinite without points."""
    if not len(points) or not len(way):
        return np.inf
    return float(scipy.spatial.KDTree(points).query(way)[0].min())
