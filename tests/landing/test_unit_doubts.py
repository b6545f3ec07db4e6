"""Values that are surely in another unit, each beside the value in the right one; real vehicles leave no doubt."""

import dataclasses
import warnings
from typing import Any

import numpy as np
import pytest

import jaxscp

NUMBERS: dict[str, Any] = {
    "mass": 0.928,
    "inertia": [2.5e-3, 2.1e-3, 4.3e-3],
    "arm": 0.076,
    "torque_ratio": 0.016,
    "thrust_min": 0.3,
    "thrust_max": 5.0,
}
VEHICLES = {  # mass kg, principal moments kg m^2, arm m, torque ratio m, greatest thrust over weight
    "30 g": (0.03, [1.7e-5, 1.7e-5, 3.0e-5], 0.046, 0.006, 2.0),
    "racing": (0.6, [1.0e-3, 1.0e-3, 1.8e-3], 0.11, 0.012, 16.0),
    "heavy middle": (1.4, [5e-3, 5e-3, 6e-3], 0.35, 0.02, 2.0),
    "ring": (2.0, [0.08, 0.08, 0.16], 0.28, 0.02, 2.5),
    "25 kg": (25.0, [1.5, 1.5, 2.8], 0.8, 0.03, 1.8),
    "200 kg": (200.0, [60.0, 90.0, 140.0], 2.2, 0.12, 1.6),
}


def with_vehicle(frame, **limits):
    scenario = jaxscp.scenarios.platform_to_platform()
    return dataclasses.replace(scenario, airframe=frame, limits=jaxscp.flight_limits(**limits))


WRONG = {
    "arm in mm": ({"arm": 76.0}, r"airframe: a rotor is 76 m from the centre.*arm in m"),
    "arm in cm": ({"arm": 7.6}, r"airframe: a rotor is 7\.6 m from the centre.*arm in m"),
    "thrust in gram-force": ({"thrust_max": 510.0}, r"airframe\.thrust_max: 510 N.* 224 times the weight"),
    "torque ratio in mm": ({"torque_ratio": 16.0}, r"torque_map: .* drag torque is 16 m .*torque_ratio in m"),
    "torque ratio in cm": (
        {"torque_ratio": 1.6},
        r"torque_map: .* drag torque is 1\.6 m .*torque_ratio in m",
    ),
    "inertia in dm^2": ({"inertia": [0.25, 0.21, 0.43]}, r"body\.inertia: .* 0\.692 m, 8\.9 times.*kg m\^2"),
}


@pytest.mark.parametrize("name", WRONG)
def test_another_unit_is_suspected(name):
    change, words = WRONG[name]
    with warnings.catch_warnings(record=True, action="always") as found:
        jaxscp.validate(with_vehicle(jaxscp.airframes.multirotor(**{**NUMBERS, **change}, radius=0.076)))
    assert len(found) == 1
    with pytest.warns(UserWarning, match=words):
        warnings.warn(found[0].message, stacklevel=1)


def test_the_names_of_numbers_are_right_where_the_hull_follows_the_arm():
    numbers: dict[str, Any] = {**NUMBERS, "arm": 350.0}
    long = jaxscp.airframes.multirotor(**numbers)
    with pytest.warns(UserWarning, match="airframe: a rotor is 350 m from the centre"):
        jaxscp.validate(with_vehicle(long))


@pytest.mark.parametrize("name", VEHICLES)
def test_real_vehicles_leave_no_doubt(name):
    mass, inertia, arm, ratio, lift = VEHICLES[name]
    most = lift * mass * 9.81 / 4.0
    frame = jaxscp.airframes.multirotor(
        mass=mass, inertia=inertia, arm=arm, torque_ratio=ratio, thrust_min=0.0, thrust_max=most
    )
    jaxscp.validate(with_vehicle(frame, body_rate=35.0))


def test_shipped_vehicles_leave_no_doubt():
    frames = jaxscp.airframes
    for make in (frames.paper_mav, frames.paper_carrier, frames.crazyflie2, frames.tilted_quadrotor):
        jaxscp.validate(with_vehicle(make()))


def test_a_body_rate_in_degrees_is_suspected():
    frame = jaxscp.airframes.paper_mav()
    with pytest.warns(UserWarning, match=r"limits\.body_rate: 300 rad/s are 48 turns .*np\.radians\(300\)"):
        jaxscp.validate(with_vehicle(frame, body_rate=300.0))
    jaxscp.validate(with_vehicle(frame, body_rate=np.radians(300.0)))
