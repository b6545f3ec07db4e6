"""Inertia of a vehicle against its mass and size: units and typing errors show here."""

from typing import Any

import numpy as np

from jaxscp.dynamics.airframes import Airframe
from jaxscp.landing.rule import Rule, short

FARTHEST = 10.0  # reaches of the vehicle: greatest radius of gyration; real vehicles have 0.3 to 1.5
SCATTER = 0.3  # fraction by which moments, measured or of a study, may break the triangle inequality
_TINY = 1e-12


def radius_of_gyration(airframe: Airframe, xp: Any) -> Any:
    """Root mean square distance in m of the mass from its centre: sqrt(trace J / 2 m).

    Example:
        >>> import jaxscp, numpy as np
        >>> round(float(radius_of_gyration(jaxscp.airframes.paper_mav(), np)), 3)
        0.069
    """
    trace = xp.trace(airframe.body.inertia)
    return xp.sqrt(xp.maximum(trace, 0.0) / (2.0 * xp.maximum(airframe.body.mass, _TINY)))


def reach(airframe: Airframe, xp: Any) -> Any:
    """Greatest lever of a rotor, or the hull's radius where it is greater; m.

    Example:
        >>> import jaxscp, numpy as np
        >>> round(float(reach(jaxscp.airframes.paper_mav(), np)), 3)
        0.078
    """
    torques, thrusts = (
        xp.sqrt(xp.sum(of**2, axis=0)) for of in (airframe.body.torque_map, airframe.body.thrust_map)
    )
    lever = xp.max(torques / xp.maximum(thrusts, _TINY), initial=0.0)
    return xp.maximum(lever, airframe.radius)


def inertia_rule(airframe: Airframe, xp: Any) -> Rule:
    """The mass lies within ten reaches of the vehicle: an inertia of another unit does not."""
    mass, spread, size = airframe.body.mass, radius_of_gyration(airframe, xp), reach(airframe, xp)
    return Rule(
        (spread <= FARTHEST * size) | (size <= 0.0) | (mass <= 0.0),
        f"airframe.body.inertia: at a mass of {short(mass)} kg its radius of gyration is {short(spread)} m, over ten "
        f"times the vehicle's reach, {short(size)} m. Units are kg m^2: 1 g cm^2 is 1e-7 kg m^2.",
    )


def inertia_doubt(airframe: Airframe) -> str:
    """Text on principal moments that no body has: each is at most the sum of the others. Empty if there is no doubt.

    Example:
        >>> import jaxscp
        >>> inertia_doubt(jaxscp.airframes.paper_mav())
        ''
    """
    least, middle, most = np.linalg.eigvalsh(np.asarray(airframe.body.inertia)).tolist()
    if most <= (1.0 + SCATTER) * (least + middle):
        return ""
    return (
        f"airframe.body.inertia: no body has the principal moments {least:.3g}, {middle:.3g} and {most:.3g} kg m^2: "
        "each must be at most the sum of the other two"
    )
