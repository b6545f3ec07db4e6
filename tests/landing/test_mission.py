"""Parts of a mission from plain numbers: what contradicts itself is named."""

import dataclasses
import inspect  # to leave out the checks of annotations, which come first in tests

import numpy as np
import pytest

import jaxscp


@pytest.mark.parametrize(
    ("centres", "semi_axes"),
    [
        ([[3.0, 2.0]], 0.3),
        ([[3.0, 2.0, 1.0]], [0.3] * 4),
        ([[3.0, 2.0, 1.0]] * 2, [[0.3, 0.3]] * 2),
        ([[3.0, 2.0, 1.0]], -0.5),
    ],
)
def test_ellipsoids_that_contradict_themselves_are_refused(centres, semi_axes):
    with pytest.raises(ValueError, match="ellipsoids: "):
        jaxscp.ellipsoids(centres, semi_axes)


@pytest.mark.parametrize("semi_axes", [0.5, [0.5], [0.5, 0.5], [[0.5, 0.5, 0.5]], [[0.5] * 3] * 2])
def test_balls_may_be_stated_in_any_way(semi_axes):
    found = jaxscp.ellipsoids([[3.0, 2.0, 1.0], [1.0, 2.0, 1.0]], semi_axes)
    np.testing.assert_array_equal(found.shapes, np.broadcast_to(2.0 * np.eye(3), (2, 3, 3)))


def test_fixed_components_name_what_is_wrong():
    np.testing.assert_array_equal(jaxscp.fixed(attitude=0.0).attitude, np.zeros(3))
    with pytest.raises(ValueError, match="attitude: expected three numbers, got shape"):
        jaxscp.fixed(attitude=[1.0, 1.0])
    with pytest.raises(ValueError, match="position: expected three numbers, got"):
        jaxscp.fixed(position="a")


@pytest.mark.parametrize("count", [0, 12, 14])
def test_a_state_of_another_length_is_refused(count):
    with pytest.raises(ValueError, match=rf"expected 13 numbers: .*got shape \({count},\)"):
        inspect.unwrap(jaxscp.BodyState.of.__func__)(jaxscp.BodyState, np.zeros(count))


def test_a_yaw_in_degrees_is_warned_of():
    with pytest.warns(UserWarning, match=r"yaw: 90 rad is beyond a whole turn; .* np\.radians\(90\)"):
        jaxscp.at_rest([0.0, 0.0, 1.0], 90.0)
    jaxscp.at_rest([0.0, 0.0, 1.0], -2.0 * np.pi)
    for wrong in ("1.5", [0.1, 0.2], None):
        with pytest.raises(ValueError, match="yaw: expected one number, in radians, got"):
            inspect.unwrap(jaxscp.at_rest)([0.0, 0.0, 1.0], wrong)


def test_text_is_no_number_even_where_it_spells_one():
    with pytest.raises(ValueError, match=r"limits\.speed: expected a number, got '3'"):
        jaxscp.flight_limits(speed="3")
    with pytest.raises(ValueError, match="position: expected three numbers, got"):
        jaxscp.at_rest(["1", "2", "3"])
    with pytest.raises(ValueError, match=r"ellipsoids: semi_axes: expected numbers, got '0\.5'"):
        jaxscp.ellipsoids([[1.0, 1.0, 1.0]], "0.5")
    odd = dataclasses.replace(jaxscp.scenarios.platform_to_platform(), deck_velocity=["0", "0", "1"])
    with pytest.raises(jaxscp.InvalidScenario, match="deck_velocity: expected an array, got one of class"):
        jaxscp.validate(odd)
