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


def number(x, u, t, p):
    return u


def with_ends(first, last):
    return js.OptimalControlProblem(
        js.DoubleIntegrator(1),
        js.Cost(),
        js.Boundary(js.fixed_state(first), js.fixed_state(last)),
        PROBLEM.time,
    )


STUMBLES = {
    "fixed_state: expected one value for each component": lambda: js.fixed_state(np.array(0.0)),
    "fixed_state: names has 1 entries, values has 2": lambda: js.fixed_state([0.0, 1.0], names=("x",)),
    "final_time: must be positive and finite, got nan": lambda: js.straight_line(PROBLEM, float("nan")),
    "final_time: must be positive and finite, got -2.0": lambda: js.straight_line(PROBLEM, -2.0),
    r"boundary.final: x\[0\] is fixed at inf": lambda: js.straight_line(with_ends([0.0, 0.0], [np.inf, 0.0])),
    "times: two or more": lambda: js.Trajectory.from_arrays([1.0, 2.0], [[0.0], [0.0]], [[0.0], [0.0]]),
    "states: expected rows of numbers": lambda: js.Trajectory.from_arrays(
        [0.0, 2.0], [[0.0], [0.0, 1.0]], [[0.0], [0.0]]
    ),
    "controls: holds a value that is NaN": lambda: js.Trajectory.from_arrays(
        [0.0, 2.0], [[0.0], [0.0]], [[0.0], [np.nan]]
    ),
}


@pytest.mark.parametrize("words", STUMBLES)
def test_the_message_names_the_argument(words):
    with pytest.raises(js.InvalidProblem, match=words):
        STUMBLES[words]()


def test_an_infinite_end_is_not_blamed_on_the_guess():
    guess = js.straight_line(with_ends([0.0, 0.0], [1.0, 0.0]))
    with pytest.raises(js.InvalidProblem, match=r"^boundary\.final: x\[0\] is fixed at inf"):
        js.solve(with_ends([0.0, 0.0], [np.inf, 0.0]), guess)


@pytest.mark.filterwarnings("error")
def test_sizes_come_as_numpys_whole_numbers():
    dynamics = js.Dynamics.of(number, states=np.int64(1), controls=np.int32(1))
    assert (dynamics.state_size, dynamics.control_size) == (1, 1)
