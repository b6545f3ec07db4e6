"""Names of a multirotor's numbers: a wrong one is refused, and the message lists the right ones."""

import pytest

import jaxscp

NUMBERS = {
    "mass": 2.0,
    "inertia": [0.02, 0.02, 0.04],
    "arm": 0.25,
    "torque_ratio": 0.02,
    "thrust_min": 0.1,
    "thrust_max": 8.0,
}


def test_an_unknown_name_is_refused():
    with pytest.raises(TypeError, match=r"unknown rotor; there are arm, inertia, .*rotors"):
        jaxscp.airframes.multirotor(**NUMBERS, rotor=6)


def test_missing_names_are_listed():
    few = {name: NUMBERS[name] for name in ("mass", "arm", "thrust_max")}
    with pytest.raises(TypeError, match="inertia, thrust_min, torque_ratio must be given"):
        jaxscp.airframes.multirotor(**few)


def test_the_hull_may_be_wider_than_the_arms():
    assert float(jaxscp.airframes.multirotor(**NUMBERS).radius) == 0.25
    assert float(jaxscp.airframes.multirotor(**NUMBERS, radius=0.4).radius) == 0.4


@pytest.mark.parametrize("inertia", [0.03, [0.03, 0.03], [[0.03, 0.0], [0.0, 0.03]]])
def test_an_inertia_of_another_shape_is_named(inertia):
    with pytest.raises(ValueError, match="inertia: expected three principal moments or a 3 x 3 matrix"):
        jaxscp.airframes.multirotor(**{**NUMBERS, "inertia": inertia})
