"""Names of a multirotor's numbers: a wrong one is refused, and the message lists the right ones."""

import numpy as np
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


@pytest.mark.parametrize("name", sorted(NUMBERS))
def test_text_is_no_number(name):
    with pytest.raises(ValueError, match=f"multirotor: {name}: expected numbers, got '0.25'"):
        jaxscp.airframes.multirotor(**{**NUMBERS, name: "0.25"})


@pytest.mark.parametrize("rotors", [3.5, 4.0, "4", 0, -1, True])
def test_rotors_are_a_whole_number(rotors):
    with pytest.raises(ValueError, match="multirotor: rotors: expected a whole number, 1 or more, got"):
        jaxscp.airframes.multirotor(**NUMBERS, rotors=rotors)


def test_an_arm_is_not_negative():
    with pytest.raises(ValueError, match=r"multirotor: arm: must not be negative, got -0\.25 m"):
        jaxscp.airframes.multirotor(**{**NUMBERS, "arm": -0.25}, radius=0.3)


def test_a_negative_torque_ratio_turns_all_rotors_the_other_way():
    """The first rotor, front left, turns clockwise: its drag turns the body counter-clockwise, along +z."""
    usual = jaxscp.airframes.multirotor(**NUMBERS).body.torque_map
    other = jaxscp.airframes.multirotor(**{**NUMBERS, "torque_ratio": -0.02}).body.torque_map
    np.testing.assert_array_equal(usual[2], [0.02, -0.02, 0.02, -0.02])
    np.testing.assert_array_equal(other, usual.at[2].multiply(-1.0))
