"""Parts of a path that obstacles hide from the viewer, under parallel projection."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxscp.plot.curves import Array

_REACH = 0.8  # of the distance between neighbouring points: a surface's points hide what lies between them
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
    plane = np.linalg.svd(viewer[None])[2][1:]  # two directions of the picture
    near = KDTree(obstacles @ plane.T).query_ball_point(path @ plane.T, _REACH * max(spacing, 1e-9))
    depth, of_path = obstacles @ viewer, path @ viewer
    return np.array(
        [bool(np.any(depth[rows] >= here + spacing)) for rows, here in zip(near, of_path, strict=True)]
    )
