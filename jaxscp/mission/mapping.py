"""A map of recent scans, in the frame of the vehicle's odometry. It lives on the host."""

import numpy as np
import scipy
from jaxtyping import Float

from jaxscp.corridor import PointCloud
from jaxscp.mission.attitudes import rotations

Points = Float[np.ndarray, "_ 3"]

_NEAREST = 0.5  # m: returns of leaves beside the vehicle; obstacles were seen from afar
# m; and returns, itself included, that make an obstacle nearer and farther than that
_NEAR, _MANY, _FEW = 4.0, 4, 3
_SPACING = 0.15, 0.05  # m, and m for each metre of distance: in which its neighbours lie


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
        self._scans: list[tuple[float, Points]] = []
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
        far = np.linalg.norm(points - place, axis=1) > _NEAREST
        self._scans.append((self._way, self._denoised(points[far], place)))
        self._scans = [scan for scan in self._scans if self._way - scan[0] <= self.memory]

    def forget(self) -> None:
        """Drop all scans but the last: older ones have drifted, and leaves add up."""
        self._scans = self._scans[-1:]

    def cloud(self) -> PointCloud:
        """All points that are remembered."""
        parts = [points for _, points in self._scans]
        return PointCloud.of(np.concatenate(parts) if parts else np.zeros((0, 3)))

    def latest(self) -> Points:
        """Points of the last scan."""
        return self._scans[-1][1] if self._scans else np.zeros((0, 3))

    def _denoised(self, points: Points, place: Float[np.ndarray, "3"]) -> Points:
        """The points without those that are nearly alone: single leaves."""
        if not self.denoise or not len(points):
            return points
        distance = np.linalg.norm(points - place, axis=1)
        away = scipy.spatial.KDTree(points).query(points, k=[_FEW, _MANY])[0]
        away = np.where(distance < _NEAR, away[:, 1], away[:, 0])  # of the last neighbour that is needed
        return points[away <= _SPACING[0] + _SPACING[1] * distance]


def in_odometry_frame(
    points: Points, seen: Float[np.ndarray, "points"], state: Float[np.ndarray, "13"]
) -> Points:
    """Points of a scan from body axes into the frame of the odometry; those without return are left out."""
    return state[:3] + rotations(state[6:10]).apply(points[seen > 0.5])
