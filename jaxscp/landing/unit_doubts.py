"""Doubts about the unit of a value: no contradiction, but no real vehicle has it.

Bounds are ratios of sizes of the vehicle, and hold at every scale. Vehicles from 30 g to 200 kg keep them by far.
"""

from collections.abc import Iterator

import numpy as np

from jaxscp.dynamics.airframes import Airframe
from jaxscp.landing.inertia import inertia_doubt, radius_of_gyration, reach
from jaxscp.landing.mission import FlightLimits, Mission

SPREAD = 5.0  # radius of gyration over reach; real vehicles have 0.15 to 1.5
ARM = 30.0  # lever of a rotor over radius of gyration
TORQUE = 3.0  # drag torque over thrust, over reach; real vehicles have 0.04 to 0.3
LIFT = 60.0  # greatest thrust over weight; a racing quadrotor has 16
SPIN = 40.0  # rad/s of a body rate's limit: gyroscopes end at 35
SPIN_OF_SIZE = 4.0  # the same, over sqrt(gravity / reach); a vehicle of 30 g has 2.5


def unit_doubts(mission: Mission) -> Iterator[str]:
    """Texts, each with the field, the value and the likely cause; of a mission of NumPy's arrays that keeps all rules.

    Example:
        >>> import jax, jaxscp, numpy as np
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> list(unit_doubts(jax.tree.map(np.asarray, scenario)))
        []
    """
    frame = mission.airframe
    of_frame = (doubt(frame) for doubt in (inertia_doubt, _spread, _arm, _lift, _torque))
    yield from filter(None, (*of_frame, _spin(mission.limits, frame)))


def _spread(frame: Airframe) -> str:
    spread, size = float(radius_of_gyration(frame, np)), float(reach(frame, np))
    if size <= 0.0 or spread <= SPREAD * size:
        return ""
    return (
        f"airframe.body.inertia: at a mass of {float(frame.body.mass):.3g} kg its radius of gyration is {spread:.3g} "
        f"m, {spread / size:.2g} times the vehicle's reach, {size:.3g} m. Are the inertia in kg m^2 and the arm in m?"
    )


def _arm(frame: Airframe) -> str:
    spread, (levers, _) = float(radius_of_gyration(frame, np)), _levers(frame)
    longest = float(np.max(levers, initial=0.0))
    if longest <= ARM * spread:
        return ""
    return (
        f"airframe: a rotor is {longest:.3g} m from the centre, {longest / spread:.2g} times the radius of gyration of "
        f"mass and inertia, {spread:.3g} m. Is the arm in m, and not in cm or mm?"
    )


def _lift(frame: Airframe) -> str:
    weight = -float(frame.body.mass * frame.body.gravity[2])
    lift = float(frame.body.thrust_map[2] @ frame.thrust_max)
    if weight <= 0.0 or lift <= LIFT * weight:
        return ""
    return (
        f"airframe.thrust_max: {float(np.max(frame.thrust_max)):.4g} N; the greatest thrust of all rotors is "
        f"{lift / weight:.3g} times the weight, {weight:.3g} N. Is it in N a rotor? 1 gram-force is 0.00981 N."
    )


def _torque(frame: Airframe) -> str:
    levers, ratios = _levers(frame)
    size, largest = float(np.max(levers, initial=float(frame.radius))), float(np.max(ratios, initial=0.0))
    if size <= 0.0 or largest <= TORQUE * size:
        return ""
    return (
        f"airframe.body.torque_map: a rotor's drag torque is {largest:.3g} m times its thrust, {largest / size:.2g} "
        f"times the vehicle's reach, {size:.3g} m. Is torque_ratio in m? Real ones are some hundredths of a metre."
    )


def _levers(frame: Airframe) -> tuple[np.ndarray, np.ndarray]:
    """Torque over thrust in m, across the thrust's axis and along it, of every rotor that has a thrust."""
    thrust, torque = np.asarray(frame.body.thrust_map), np.asarray(frame.body.torque_map)
    force = np.linalg.norm(thrust, axis=0)
    thrust, torque, force = thrust[:, force > 0.0], torque[:, force > 0.0], force[force > 0.0]
    along = np.sum(thrust * torque, axis=0) / force
    across = np.sqrt(np.maximum(np.sum(torque**2, axis=0) - along**2, 0.0))
    return across / force, np.abs(along) / force


def _spin(limits: FlightLimits, frame: Airframe) -> str:
    if limits.body_rate is None:
        return ""
    rate, gravity = float(limits.body_rate), float(np.linalg.norm(frame.body.gravity))
    size = float(reach(frame, np))
    if rate <= SPIN or rate * np.sqrt(size) <= SPIN_OF_SIZE * np.sqrt(gravity):
        return ""
    turns = rate / (2.0 * np.pi)
    return (
        f"limits.body_rate: {rate:.4g} rad/s are {turns:.2g} turns a second. Was it given in degrees? Then write "
        f"np.radians({rate:g})."
    )
