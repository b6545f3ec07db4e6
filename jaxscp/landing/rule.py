"""One rule on the values of a mission, and numbers and faces in its message."""

from typing import Any, NamedTuple

import numpy as np

from jaxscp.core.arrays import namespace
from jaxscp.corridor.polytopes import Corridor

_ON_AXIS = 1e-9


class Rule(NamedTuple):
    """One requirement."""

    holds: Any
    """Array of one boolean."""
    message: str
    """Field and likely cause, for when it does not hold."""


def short(value: Any) -> str:
    """A number in three digits; one that is traced stands for no message.

    Example:
        >>> short(0.123456)
        '0.123'
    """
    return f"{float(value):.3g}" if isinstance(value, float | np.ndarray) else str(value)


def face_text(corridor: Corridor, number: int, point: Any) -> str:
    """The face of a polytope that a point is farthest beyond, in words; of one that is traced, nothing.

    Args:
        corridor: with unit normals.
        number: of the polytope.
        point: (3,) m.

    Example:
        >>> import jaxscp, numpy as np
        >>> room = jaxscp.corridor.connect([jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 3.0, 2.0])])
        >>> face_text(room, 0, np.array([1.0, 1.0, 2.5]))
        'above its face z <= 2 m'
    """
    if namespace(corridor, point) is not np:
        return ""
    normals, offsets = np.asarray(corridor.normals[number]), np.asarray(corridor.offsets[number])
    face = int(np.argmax(normals @ np.asarray(point) - offsets))
    normal, offset = normals[face], float(offsets[face])
    axis = int(np.argmax(np.abs(normal)))
    sign = float(np.sign(normal[axis]))
    if np.abs(normal[axis]) < 1.0 - _ON_AXIS:
        found = f"beyond its face with the normal ({', '.join(f'{v:.3g}' for v in normal)})"
    else:
        side = "beyond" if axis < 2 else "above" if sign > 0.0 else "below"
        found = f"{side} its face {'xyz'[axis]} {'<=' if sign > 0.0 else '>='} {sign * offset:.4g} m"
    if corridor.margin is None:
        return found
    return f"{found}; margin={float(corridor.margin):.3g} m of connect() moved that face"
