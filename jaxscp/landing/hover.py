"""Whether a vehicle can hover: thrusts within their limits that carry the weight without torque.

The upward force and the three torques of all thrusts within their limits fill a zonotope in four dimensions. The weight
must lie in it. A closed form decides this, instead of a linear program: the rule then also holds under ``jit``.
"""

import itertools
from typing import Any

import numpy as np

from jaxscp.dynamics.airframes import Airframe

_ROUNDING = 1e-9  # relative, of the largest force and torques


def can_hover(airframe: Airframe, xp: Any) -> Any:
    """Whether thrusts exist that balance weight and torque; a force across the body's z axis is left to its attitude.

    A point lies in a zonotope if no facet separates them. Each facet's normal is orthogonal to three generators. The
    four axes join the generators with length zero, which covers zonotopes without inside.

    Args:
        airframe: of NumPy's arrays, or traced ones.
        xp: numpy or jax.numpy, respectively.

    Example:
        >>> import jax, jaxscp, numpy as np
        >>> from jaxscp.landing.hover import can_hover
        >>> bool(can_hover(jax.tree.map(np.asarray, jaxscp.airframes.paper_mav()), np))
        True
    """
    body = airframe.body
    rows = xp.concatenate([body.thrust_map[2:3], body.torque_map])
    weight = -body.mass * body.gravity[2]
    # Rows of one size each, so that one tolerance serves forces and torques.
    largest = xp.max(xp.abs(rows), axis=1)
    largest = xp.where(largest > 0, largest, 1.0)
    rows = rows / largest[:, None]
    half = 0.5 * (airframe.thrust_max - airframe.thrust_min)
    middle = rows @ (0.5 * (airframe.thrust_max + airframe.thrust_min))
    carried = weight / largest[0] * np.eye(4)[0]

    generators = xp.concatenate([rows.T, xp.asarray(np.eye(4))])
    triples = np.array(list(itertools.combinations(range(generators.shape[0]), 3)))
    normals = _orthogonal(generators[triples], xp)
    reach = xp.abs(normals @ rows) @ half
    allowed = _ROUNDING * xp.sqrt(xp.sum(normals**2, axis=1)) * (xp.abs(weight) + xp.sum(xp.abs(half)))
    return xp.all(xp.abs(normals @ (carried - middle)) <= reach + allowed)


def _orthogonal(triples: Any, xp: Any) -> Any:
    """Vectors orthogonal to three others in four dimensions: (count, 3, 4) to (count, 4), by cofactors."""
    minors = []
    for column in range(4):
        a, b, c = (triples[:, :, k] for k in range(4) if k != column)
        minors.append((-1) ** column * xp.sum(a * xp.cross(b, c), axis=1))
    return xp.stack(minors, axis=1)
