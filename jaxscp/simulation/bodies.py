"""The MuJoCo model: the vehicle and the carrier as free bodies, in contact by feet and deck."""

import mujoco
import numpy as np

from jaxscp.dynamics.airframes import Airframe
from jaxscp.simulation.scene import Scene
from jaxscp.simulation.vehicles import FEET_DEPTH

GRAVITY = 0.0, 0.0, -9.81
"""Of the world, m/s^2."""
TIME_STEP = 0.0025
"""s: two steps a sample of the inertial unit, four a sample of odometry."""
DECK_HEIGHT = 0.16
"""Height of the deck's surface over the carrier's centre of mass, m."""
FOOT = 0.012
"""Radius of a foot, m."""
FEET = np.array([[x, y, FOOT - FEET_DEPTH] for x in (-0.054, 0.054) for y in (-0.054, 0.054)])
"""Centres of the feet in the vehicle's axes, m."""
_HALF_DECK = 0.4
VEHICLE, CARRIER = 1, 2
"""Numbers of the bodies in MuJoCo's arrays."""


def mjcf(vehicle: Airframe, carrier: Airframe, scene: Scene | None = None) -> str:
    """MJCF text. The scene's obstacles are shown; they touch nothing (``Scene.distance`` finds collisions).

    MuJoCo's fluid forces are off: ``Aerodynamics`` gives ours. No joint is damped, so that steps need no implicit
    damping. Inertia matrices must be diagonal.

    Example:
        >>> from jaxscp import airframes
        >>> "freejoint" in mjcf(airframes.paper_mav(), airframes.paper_carrier())
        True
    """
    feet = range(4)
    pairs = "".join(
        f'<pair geom1="foot{i}" geom2="deck" condim="4" friction="1 1 0.01 0.001 0.001"/>' for i in feet
    )
    return f"""<mujoco model="flight">
  <option timestep="{TIME_STEP}" gravity="{_text(GRAVITY)}" density="0" viscosity="0" iterations="8" ls_iterations="8">
    <flag eulerdamp="disable"/>
  </option>
  <visual><global offwidth="640" offheight="480"/><quality shadowsize="0"/></visual>
  <default><geom contype="0" conaffinity="0" mass="0"/></default>
  <worldbody>
    <light pos="0 0 20" dir="0 0 -1" directional="true"/>
    <geom name="ground" type="plane" size="60 60 1" rgba="0.85 0.85 0.82 1"/>
    <body name="vehicle"><freejoint/>{_inertial(vehicle)}
      <geom type="box" size="0.04 0.04 0.02" rgba="0.15 0.3 0.6 1"/>{_rotors(vehicle, 0.038)}{_feet()}
    </body>
    <body name="carrier" pos="0 0 1"><freejoint/>{_inertial(carrier)}
      <geom type="box" size="0.15 0.15 0.08" rgba="0.3 0.3 0.3 1"/>{_rotors(carrier, 0.2)}
      <geom name="deck" type="box" size="{_HALF_DECK} {_HALF_DECK} 0.01" pos="0 0 {DECK_HEIGHT - 0.01}"
        rgba="0.7 0.5 0.2 1"/>
    </body>
    {"" if scene is None else _obstacles(scene)}
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>"""


def model(vehicle: Airframe, carrier: Airframe, scene: Scene | None = None) -> mujoco.MjModel:  # pyright: ignore[reportAttributeAccessIssue]
    """The compiled model."""
    return mujoco.MjModel.from_xml_string(mjcf(vehicle, carrier, scene))  # pyright: ignore[reportAttributeAccessIssue]


def _inertial(airframe: Airframe) -> str:
    inertia = np.diag(np.asarray(airframe.body.inertia))
    return f'<inertial pos="0 0 0" mass="{float(airframe.body.mass)}" diaginertia="{_text(inertia)}"/>'


def _rotors(airframe: Airframe, radius: float) -> str:
    """Discs at the ends of the arms, from the torque map of upright rotors: torque = (y, -x, ...)."""
    y, minus_x = np.asarray(airframe.body.torque_map)[:2]
    return "".join(
        f'<geom type="cylinder" size="{radius} 0.004" pos="{-mx} {py} 0.02" rgba="0.1 0.1 0.1 0.5"/>'
        for mx, py in zip(minus_x, y, strict=True)
    )


def _feet() -> str:
    return "".join(
        f'<geom name="foot{i}" type="sphere" size="{FOOT}" pos="{_text(place)}"/>'
        for i, place in enumerate(FEET)
    )


def _obstacles(scene: Scene) -> str:
    boxes = (
        f'<geom type="box" pos="{_text(centre)}" size="{_text(half)}" rgba="0.5 0.6 0.5 1"/>'
        for centre, half in zip(np.asarray(scene.centres), np.asarray(scene.halves), strict=True)
    )
    cylinders = (
        f'<geom type="cylinder" pos="{x} {y} {h / 2}" size="{r} {h / 2}" rgba="0.5 0.4 0.3 1"/>'
        for (x, y), r, h in zip(*map(np.asarray, (scene.axes, scene.radii, scene.heights)), strict=True)
    )
    return "".join((*boxes, *cylinders))


def _text(numbers) -> str:
    return " ".join(str(float(n)) for n in numbers)
