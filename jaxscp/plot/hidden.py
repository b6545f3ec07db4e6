"""Parts of a path that obstacles hide from the viewer, under parallel projection, and rooms cut open."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxscp.plot.curves import Array

_REACH = 0.8  # of the distance between neighbouring points: a surface's points hide what lies between them
_MOST = 0.5  # of the path may be hidden before a room is cut open
_FEW = 500  # points whose distances to neighbours are typical


def toward_viewer(elevation: float, azimuth: float) -> Float[np.ndarray, "3"]:
    """Unit vector from the scene to the viewer; angles in degrees, as matplotlib's."""
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def hidden(
    path: Float[np.ndarray, "samples 3"], obstacles: Float[np.ndarray, "points 3"], viewer: Array
) -> Bool[np.ndarray, "samples"]:
    """Whether an obstacle point lies between a sample of a path and the viewer.

    Args:
        path: positions, m.
        obstacles: points on surfaces, m.
        viewer: unit vector to the viewer.

    Example:
        >>> import numpy as np
        >>> wall = np.array([[0.0, y, z] for y in np.arange(5.0) for z in np.arange(5.0)])
        >>> hidden(np.array([[-1.0, 2.2, 2.2], [1.0, 2.2, 2.2]]), wall, np.array([1.0, 0.0, 0.0])).tolist()
        [True, False]
    """
    if len(obstacles) < 2:
        return np.zeros(len(path), bool)
    some = obstacles[:: max(1, len(obstacles) // _FEW)]
    spacing = np.median(KDTree(obstacles).query(some, k=2)[0][:, 1])
    plane = _picture_plane(viewer)
    near = KDTree(obstacles @ plane.T).query_ball_point(path @ plane.T, _REACH * max(spacing, 1e-9))
    depth, of_path = obstacles @ viewer, path @ viewer
    return np.array(
        [bool(np.any(depth[rows] >= here + spacing)) for rows, here in zip(near, of_path, strict=True)]
    )


def _picture_plane(viewer: Array) -> Float[np.ndarray, "2 3"]:
    """Two directions of the picture."""
    return np.linalg.svd(viewer[None])[2][1:]


def cut_open(
    obstacles: Float[np.ndarray, "points 3"], path: Float[np.ndarray, "samples 3"], viewer: Array
) -> Float[np.ndarray, "shown 3"]:
    """Obstacle points without those in front of the path, if these hide most of it: a room without its near walls.

    Args:
        obstacles: points on surfaces, m.
        path: positions, m.
        viewer: unit vector to the viewer.

    Example:
        >>> import numpy as np
        >>> wall = np.array([[0.0, y, z] for y in np.arange(5.0) for z in np.arange(5.0)])
        >>> inside, toward = np.array([[-1.0, 2.2, 2.2], [-1.0, 3.2, 2.2]]), np.array([1.0, 0.0, 0.0])
        >>> len(cut_open(wall, inside, toward)), len(cut_open(wall, -inside, toward))
        (0, 25)
    """
    if np.mean(hidden(path, obstacles, viewer)) <= _MOST:
        return obstacles
    plane = _picture_plane(viewer)
    nearest = KDTree(path @ plane.T).query(obstacles @ plane.T)[1]
    return obstacles[obstacles @ viewer <= path[nearest] @ viewer]


def at_height_of(
    path: Float[np.ndarray, "samples 3"], obstacles: Float[np.ndarray, "points 3"], reach: float = 0.5
) -> Float[np.ndarray, "shown 3"]:
    """For a view from above: points within a height of the path beside them, if floor or ceiling cover most of it.

    Args:
        path: positions, m.
        obstacles: points on surfaces, m.
        reach: above and below the path, m.

    Example:
        >>> import numpy as np
        >>> floor = np.array([[x, y, 0.0] for x in np.arange(5.0) for y in np.arange(5.0)])
        >>> wall = np.array([[4.0, y, 1.0] for y in np.arange(5.0)])
        >>> flight = np.array([[x, 2.0, 1.2] for x in np.arange(4.0)])
        >>> len(at_height_of(flight, np.vstack([floor, wall]))), len(at_height_of(flight, wall))
        (5, 5)
    """
    up = np.array([0.0, 0.0, 1.0])
    if max(np.mean(hidden(path, obstacles, way)) for way in (up, -up)) <= _MOST:
        return obstacles
    nearest = KDTree(path[:, :2]).query(obstacles[:, :2])[1]
    return obstacles[np.abs(obstacles[:, 2] - path[nearest, 2]) <= reach]
