"""A motion that a vehicle can fly: from rest to rest along straight legs, slow enough for its rotors.

A rigid body with rotors along its z axis is flat: position and heading give attitude, body rates and thrusts (Mellinger
and Kumar, "Minimum snap trajectory generation and control for quadrotors", 2011). The heading stays as it is. The
motion on each leg is a polynomial of ninth degree. Its derivatives up to the fourth are zero at both ends, so that the
thrusts are continuous. Convex boxes hold the straight legs; the rotors' limits are checked here.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jaxscp.dynamics.airframes import Airframe

SAMPLES = 400  # of a leg
STRETCH = 1.3  # from one trial of a leg's time to the next
# s(0) = 0, s(1) = 1, four derivatives zero at both ends; coefficients of t^5 to t^9
SMOOTH = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126.0, -420.0, 540.0, -315.0, 70.0])


class Witness(NamedTuple):
    """A motion that can be flown."""

    duration: float
    """s"""
    thrust_use: float
    """Largest thrust of a rotor over its limit."""


def witness(airframe: Airframe, points: np.ndarray, longest: float) -> Witness | None:
    """The motion along way-points; None if it takes longer than ``longest`` seconds.

    Args:
        airframe: whose rotors must suffice, with a tenth of their range to spare.
        points: (legs + 1, 3) m, in axes of the vehicle's heading.
        longest: s.
    """
    total, use = 0.0, 0.0
    for first, last in pairwise(points):
        duration = 0.3
        while (worst := _thrust_use(airframe, last - first, duration)) is None:
            duration *= STRETCH
            if duration > longest:
                return None
        total, use = total + duration, max(use, worst)
    return Witness(total, use) if total <= longest else None


def _thrust_use(airframe: Airframe, way: np.ndarray, duration: float) -> float | None:
    """Largest thrust over its limit on a leg, or None if a rotor's limit does not hold."""
    body, time = airframe.body, np.linspace(0.0, duration, SAMPLES)
    acceleration = way * SMOOTH.deriv(2)(time / duration)[:, None] / duration**2
    force = float(body.mass) * (acceleration - np.asarray(body.gravity))
    up = force / np.linalg.norm(force, axis=1)[:, None]
    # Rotation from z to ``up`` without turn about it: the body rate is up x d up.
    rate_of = lambda v: np.gradient(v, time, axis=0, edge_order=2)  # noqa: E731
    rate = np.cross(up, rate_of(up))
    spin = rate_of(rate)
    inertia = np.asarray(body.inertia)
    # On a straight leg the body turns about one horizontal axis alone, whose components in body axes do not change.
    torque = spin @ inertia.T + np.cross(rate, rate @ inertia.T)
    maps = np.concatenate([np.asarray(body.thrust_map)[2:], np.asarray(body.torque_map)])
    demand = np.concatenate([np.linalg.norm(force, axis=1)[:, None], torque], axis=1)
    thrusts = np.linalg.lstsq(maps, demand.T, rcond=None)[0].T
    low, high = np.asarray(airframe.thrust_min), np.asarray(airframe.thrust_max)
    margin = 0.1 * (high - low)
    if np.any(thrusts < low + margin) or np.any(thrusts > high - margin):
        return None
    return float(np.max(thrusts / high))
