"""Units and frames of files: how to bring their points to metres, z up."""

import numpy as np
from jaxtyping import Float

UNITS = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "in": 0.0254,
    "ft": 0.3048,
    "us-ft": 1200.0 / 3937.0,
}
"""Metres in each unit."""

_UP = np.eye(3)
FRAMES = {
    "enu": _UP,
    "flu": _UP,
    "world": _UP,
    "sensor": _UP,
    "ned": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "frd": np.diag([1.0, -1.0, -1.0]),
    "y-up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Matrix from each frame to z up: enu and flu are z up; ned and frd are z down; world and sensor say how to
read a VIEWPOINT."""


def metres(unit: str) -> float:
    """Metres in a unit.

    Raises:
        ValueError: the unit is unknown.

    Example:
        >>> metres("mm")
        0.001
    """
    if unit not in UNITS:
        raise ValueError(f"unknown unit {unit!r}; known are {', '.join(UNITS)}")
    return UNITS[unit]


def to_z_up(frame: str) -> Float[np.ndarray, "3 3"]:
    """Matrix from a frame to z up.

    Raises:
        ValueError: the frame is unknown.

    Example:
        >>> (to_z_up("ned") @ [1.0, 2.0, 3.0]).tolist()
        [2.0, 1.0, -3.0]
    """
    if frame not in FRAMES:
        raise ValueError(f"unknown frame {frame!r}; known are {', '.join(FRAMES)}")
    return FRAMES[frame]
