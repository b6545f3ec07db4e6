"""Rows of one constraint, or of one group of an end, with sizes of their own."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from jaxscp.problem.sizes import end_measures, measured_sizes, size_of_constraint, sizes_of_rows

SCALE = js.Scale(state=[1.0, 1e-3], control=[2e4, 0.2], time=1.0, cost=1.0)
GUESS = js.Trajectory.from_arrays([0.0, 1.0], np.zeros((2, 2)), np.zeros((2, 2)))


def test_rows_of_about_one_size_share_it():
    np.testing.assert_array_equal(sizes_of_rows(jnp.array([2.0, 30.0, 1.1])), [30.0, 30.0, 30.0])
    np.testing.assert_array_equal(sizes_of_rows(jnp.array([2e4, 0.2])), [2e4, 0.2])
    # none, and rounding, say nothing
    np.testing.assert_array_equal(sizes_of_rows(jnp.array([2e4, 0.0, 1e-12])), [2e4, 2e4, 2e4])
    np.testing.assert_array_equal(sizes_of_rows(jnp.zeros(2)), [1.0, 1.0])


def test_a_force_and_an_angle_have_their_own_sizes_and_a_cone_has_one():
    limits = js.bounds(control=([-2e4, -0.2], [2e4, 0.2]))
    np.testing.assert_allclose(size_of_constraint(limits, SCALE, GUESS), [2e4, 0.2, 2e4, 0.2])
    cone = js.Constraint(lambda x, u, t, p: u, js.SecondOrder())
    assert size_of_constraint(cone, SCALE, GUESS).shape == ()
    soft = js.Constraint(lambda x, u, t, p: u, js.NonNegative(), soft=1.0)
    assert size_of_constraint(soft, SCALE, GUESS).shape == ()


def test_rows_of_an_end_that_are_far_smaller_count_more():
    both = js.EndCondition(lambda x, t, p: x, rows=(js.EndRows("state", count=2),))
    boundary, time = js.Boundary(both, both), js.Time(2, js.FixedTime(1.0))
    problem = js.OptimalControlProblem(js.DoubleIntegrator(1), js.Cost(), boundary, time)
    measure = end_measures(boundary, measured_sizes(problem, SCALE, GUESS))["final"][0]
    np.testing.assert_allclose(measure.weights, [1.0, 1e3])
    np.testing.assert_allclose(measure.tolerance, 1e-3)


@pytest.mark.parametrize("tolerance", [np.nan, 0.0, -1.0])
def test_a_tolerance_of_an_end_is_a_positive_number(tolerance):
    with pytest.raises(js.InvalidProblem, match="tolerance must be one positive number"):
        js.fixed_state([0.0, 0.0], tolerance=tolerance)


@pytest.mark.parametrize("chosen", [[-1], [0, 0]])
def test_periodic_takes_different_components_from_zero_on(chosen):
    with pytest.raises(js.InvalidProblem, match="periodic: different components"):
        js.periodic(chosen)


def test_a_periodic_component_that_does_not_exist_is_named():
    with pytest.raises(js.InvalidProblem, match="periodic: component 7 of 2 states does not exist"):
        js.periodic([7]).value(jnp.zeros(2), jnp.zeros(2), 1.0)
