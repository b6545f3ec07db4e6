"""The VIEWPOINT of a .pcd: the pose of its sensor, which some programs store with points already in the world."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxscp.corridor.file_content import CloudFileError

_CLEAR = 0.3
"""Distance from a sensor to the nearest surface that it sees, at least, metres."""
_FLOOR = 0.4
_LEVEL = 0.01
_DECISIVE = 3.0
_UNIT = 0.05
"""Largest difference of a quaternion's length from one: headers may be rounded to one digit."""


def check_pose(path: Path, pose: Sequence[float]) -> None:
    """Refuse a VIEWPOINT that is no pose.

    Args:
        path: the file, for messages.
        pose: (7,) what should be a position and a unit quaternion (w, x, y, z).

    Raises:
        CloudFileError: it is none.
    """
    numbers = np.array(pose, float)
    if not (np.isfinite(numbers).all() and abs(np.linalg.norm(numbers[3:]) - 1.0) <= _UNIT):
        raise CloudFileError(
            f"{path}: VIEWPOINT {_words(pose)} is no pose: x, y, z and a unit quaternion (w, x, y, z). "
            "Mend the header; or state frame='world' (--frame world) if the points are in the world already"
        )


def from_sensor(
    points: Float[np.ndarray, "points 3"], viewpoint: Sequence[float]
) -> Float[np.ndarray, "points 3"]:
    """Points relative to a sensor, moved to the world by its pose.

    Args:
        points: (points, 3) relative to the sensor.
        viewpoint: (7,) the sensor's position in the same unit, and its quaternion (w, x, y, z).

    Example:
        >>> from_sensor(np.zeros((1, 3)), [0.5, -2.0, 1.0, 1.0, 0.0, 0.0, 0.0]).tolist()
        [[0.5, -2.0, 1.0]]
    """
    w, x, y, z = viewpoint[3:]
    turn = Rotation.from_quat([x, y, z, w])
    return turn.apply(points) + np.array(viewpoint[:3])


def guessed_frame(
    path: Path, points: Float[np.ndarray, "points 3"], pose: Sequence[float]
) -> tuple[str, str]:
    """Whether points are relative to their sensor ("sensor") or already in the world ("world"), and a note of it.

    Two facts tell. No surface is near a sensor. In the world, floors are level.

    Args:
        path: the file, for messages.
        points: (points, 3) metres; copies of the origin are returns that never came.
        pose: (7,) the sensor's position in metres, and its quaternion (w, x, y, z).

    Raises:
        CloudFileError: neither fact tells.
    """
    seen = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    position = np.array(pose[:3])
    words = _words(pose)
    clear = min(_CLEAR, 0.5 * float(np.linalg.norm(position)))
    ways = {"sensor": _nearest(seen, np.zeros(3)) >= clear, "world": _nearest(seen, position) >= clear}
    if ways["sensor"] == ways["world"]:
        tilts = {"sensor": _tilt(from_sensor(seen, pose)), "world": _tilt(seen)}
        most, least = max(tilts.values()), min(tilts.values())
        ways = {
            name: least < _LEVEL and most > _DECISIVE * least and tilt == least
            for name, tilt in tilts.items()
        }
    if ways["sensor"] == ways["world"]:
        raise CloudFileError(
            f"{path}: VIEWPOINT {words}: are its points relative to that sensor, or already in the world? "
            "State it: frame='sensor' or frame='world' (--frame)"
        )
    kind = "sensor" if ways["sensor"] else "world"
    return kind, f"VIEWPOINT {words} is {'applied' if kind == 'sensor' else 'not applied'}: frame {kind!r}"


def _words(pose: Sequence[float]) -> str:
    return " ".join(f"{value:g}" for value in pose)


def _nearest(points: np.ndarray, place: np.ndarray) -> float:
    return float(np.sqrt(np.min(np.sum((points - place) ** 2, axis=1), initial=np.inf)))


def _tilt(points: np.ndarray) -> float:
    """Slope of the plane through the lowest points."""
    if len(points) < 3:
        return float("inf")
    low = points[points[:, 2] <= np.quantile(points[:, 2], _FLOOR)]
    slopes = np.linalg.lstsq(np.column_stack([low[:, :2], np.ones(len(low))]), low[:, 2], rcond=None)[0]
    return float(np.hypot(slopes[0], slopes[1]))
