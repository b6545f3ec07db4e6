"""Guesses."""

import numpy as np
import pytest

import jaxscp as js
from tests.support.own_problems import double_integrator, squared_control

PROBLEM = double_integrator(js.Cost(running=squared_control), js.Time(4, js.FixedTime(2.0)))


@pytest.mark.parametrize("control", [[0.5], np.array([0.5]), (0.5,)])
def test_a_straight_line_takes_a_constant_control(control):
    line = js.straight_line(PROBLEM, control=control)
    np.testing.assert_array_equal(line.control, np.full((4, 1), 0.5))
    np.testing.assert_array_equal(line.state, js.straight_line(PROBLEM).state)


def test_a_control_of_another_size_is_refused():
    with pytest.raises(
        js.InvalidProblem, match=r"control: expected 1 values, one for each control, got \(2,\)"
    ):
        js.straight_line(PROBLEM, control=[1.0, 2.0])


@pytest.mark.parametrize("flags", [[True, False], (True, False), np.array([True, False])])
def test_flags_of_a_constraint_come_as_lists_and_arrays(flags):
    constraint = js.Constraint(lambda x, u, t, p: x[:1], js.NonNegative(), active=flags)
    np.testing.assert_array_equal(constraint.active, [True, False])
