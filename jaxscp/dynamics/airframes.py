"""Vehicles as data: a rigid body and the limits of its rotors, with the source of every number."""

from collections.abc import Mapping
from typing import Any, NotRequired, TypedDict, Unpack

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats, floats, namespace, numbers
from jaxscp.core.types import Scalar
from jaxscp.dynamics.rigid_body import RigidBody

GRAVITY = 9.81  # m/s^2


class Airframe(eqx.Module):
    """A rigid body, its rotors' limits and its size."""

    body: RigidBody
    thrust_min: Float[Array, "rotors"] = eqx.field(converter=as_floats)
    """Least thrust of each rotor in N."""
    thrust_max: Float[Array, "rotors"] = eqx.field(converter=as_floats)
    """Greatest thrust of each rotor in N."""
    radius: Scalar = eqx.field(converter=as_floats)
    """Half the motor-to-motor diagonal in m: the least safety margin."""


class MultirotorNumbers(TypedDict):
    """Keyword arguments of ``multirotor``."""

    mass: Scalar | float
    inertia: Any
    arm: Scalar | float
    torque_ratio: Scalar | float
    thrust_min: Scalar | float
    thrust_max: Scalar | float
    rotors: NotRequired[int]
    tilt: NotRequired[Scalar | float]
    radius: NotRequired[Scalar | float]


def multirotor(**given: Unpack[MultirotorNumbers]) -> Airframe:
    """Rotors on a circle, the first at 45 degrees (quadrotor) or half a spacing, spinning alternately.

    Args:
        given: keyword arguments, as follows.
            mass: kg.
            inertia: kg m^2, three principal moments or a 3 x 3 matrix.
            arm: distance of the rotors from the centre in m.
            torque_ratio: drag torque per thrust (kappa) in m. Positive where the first rotor, front left, turns
                clockwise seen from above; negative where all rotors turn the other way.
            thrust_min: N for each rotor.
            thrust_max: N for each rotor.
            rotors: number of rotors, four by default.
            tilt: angle in radians by which each rotor leans about its arm, alternately left and right; zero by default.
            radius: of the hull in m; by default ``arm``, which leaves out the propellers.

    Returns:
        The airframe; body x points forward, y left, z up.

    Raises:
        TypeError: if a number is missing, or a name is unknown.
        ValueError: if ``inertia`` is neither three moments nor a matrix, an entry is no number, ``arm`` is negative,
            or ``rotors`` is no whole number.

    Example:
        >>> from jaxscp import airframes
        >>> hexa = airframes.multirotor(mass=2.0, inertia=[0.02, 0.02, 0.04], arm=0.3, torque_ratio=0.02,
        ...                             thrust_min=0.1, thrust_max=8.0, rotors=6)
        >>> hexa.body.control_size
        6
    """
    _check_names(given)
    xp, rotors, values = namespace(given), _count(given.get("rotors", 4)), _values(given)
    arm, torque_ratio, tilt = values["arm"], values["torque_ratio"], values.get("tilt", 0.0)
    angle = (np.arange(rotors) + 0.5) * 2.0 * np.pi / rotors
    spin = np.where(np.arange(rotors) % 2 == 0, 1.0, -1.0)
    position = arm * np.stack([np.cos(angle), np.sin(angle), np.zeros(rotors)])
    sideways = np.stack([-np.sin(angle), np.cos(angle), np.zeros(rotors)])
    axis = xp.sin(spin * tilt) * sideways + xp.cos(tilt) * np.array([[0.0], [0.0], [1.0]])
    torque = xp.cross(position, axis, axis=0) + torque_ratio * spin * axis
    body = RigidBody(
        mass=floats(values["mass"]),
        inertia=_inertia_matrix(values["inertia"], xp),
        thrust_map=floats(axis),
        torque_map=floats(torque),
        gravity=floats([0.0, 0.0, -GRAVITY]),
    )
    least, most = (floats(xp.full(rotors, limit)) for limit in (values["thrust_min"], values["thrust_max"]))
    return Airframe(body, least, most, floats(values.get("radius", arm)))


def _values(given: Mapping[str, Any]) -> dict[str, Any]:
    """All numbers but the count of rotors, as arrays of floats."""
    values = {name: numbers(f"multirotor: {name}", v) for name, v in given.items() if name != "rotors"}
    arm = values["arm"]
    if isinstance(arm, np.ndarray) and np.any(arm < 0.0):
        raise ValueError(f"multirotor: arm: must not be negative, got {arm} m")
    return values


def _count(rotors: Any) -> int:
    if isinstance(rotors, bool) or not isinstance(rotors, int | np.integer) or rotors < 1:
        raise ValueError(f"multirotor: rotors: expected a whole number, 1 or more, got {rotors!r}")
    return int(rotors)


def _inertia_matrix(moments: Any, xp: Any) -> Float[Array, "3 3"]:
    if moments.shape not in ((3,), (3, 3)):
        raise ValueError(
            f"inertia: expected three principal moments or a 3 x 3 matrix, got shape {moments.shape}"
        )
    return floats(xp.diag(moments) if moments.ndim == 1 else moments)


def _check_names(given: Mapping[str, Any]) -> None:
    required, optional = MultirotorNumbers.__required_keys__, MultirotorNumbers.__optional_keys__
    if missing := sorted(required - set(given)):
        raise TypeError(f"multirotor: {', '.join(missing)} must be given")
    if unknown := sorted(set(given) - required - optional):
        raise TypeError(
            f"multirotor: unknown {', '.join(unknown)}; there are {', '.join(sorted(required | optional))}"
        )


def paper_mav() -> Airframe:
    """The paper's micro aerial vehicle: 0.928 kg, 15.2 cm diagonal (so arms of 7.6 cm).

    The paper gives neither inertia nor limits. Inertia: diag(2.5, 2.1, 4.3) g m^2, as of similar vehicles of
    this mass with a centred battery. Thrust 0.3 to 5 N a rotor: a thrust-to-weight ratio of 2.2, and rotors
    that never stop. Drag torque ratio 0.016 m, common for 3-inch propellers.
    """
    return multirotor(
        mass=0.928,
        inertia=[2.5e-3, 2.1e-3, 4.3e-3],
        arm=0.076,
        torque_ratio=0.016,
        thrust_min=0.3,
        thrust_max=5.0,
    )


def paper_carrier() -> Airframe:
    """The paper's carrier with its deck: 13.1 kg, 106.8 cm diagonal.

    Inertia is ours: a disc of the vehicle's radius with a third of its mass spread over it, the rest within
    20 cm of the centre. Thrust 2 to 60 N a rotor: a thrust-to-weight ratio of 1.9, enough to lift the MAV.
    """
    return multirotor(
        mass=13.1, inertia=[0.45, 0.45, 0.80], arm=0.534, torque_ratio=0.018, thrust_min=2.0, thrust_max=60.0
    )


def crazyflie2() -> Airframe:
    """Bitcraze Crazyflie 2: 27 g, arms of 46 mm.

    Mass, inertia and torque ratio as identified by J. Foerster, "System Identification of the Crazyflie 2.0
    Nano Quadrocopter" (ETH Zurich, 2015); thrust up to 0.15 N a rotor, with a full battery.
    """
    return multirotor(
        mass=0.027,
        inertia=[1.66e-5, 1.66e-5, 2.93e-5],
        arm=0.046,
        torque_ratio=0.00596,
        thrust_min=0.002,
        thrust_max=0.15,
    )


def tilted_quadrotor(tilt: float = 0.35) -> Airframe:
    """The paper's vehicle with its rotors leaning about their arms by 20 degrees (0.35 rad), alternately.

    Tilted rotors give yaw authority from thrust rather than from drag.
    """
    return multirotor(
        mass=0.928,
        inertia=[2.5e-3, 2.1e-3, 4.3e-3],
        arm=0.076,
        torque_ratio=0.016,
        thrust_min=0.3,
        thrust_max=5.0,
        tilt=tilt,
    )
