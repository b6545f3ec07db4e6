"""Second-order conditions as numbers: values, derivatives, and curvature, compared with automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.cones.cone import SecondOrder
from jaxscp.nlp import ratio_form
from jaxscp.problem.multipliers import Multipliers

ROUNDING = 1e-12
INPUTS = 5


def height(v):
    return 0.5 * (v[0] - v[1:] @ v[1:] / v[0])


def random_case(seed, rows=4):
    """One condition: value, its Jacobian in some variables, slack and multiplier, each with axes for a location."""
    random = np.random.default_rng(seed)
    value = np.concatenate([random.uniform(0.5, 2.0, 1), random.uniform(-1.0, 1.0, rows - 1)])
    slack, multiplier = np.zeros(rows), np.zeros(rows)
    slack[0], multiplier[0] = random.uniform(0.1, 2.0, 2)
    jacobian = random.standard_normal((rows, INPUTS))
    return (jnp.asarray(v)[None, None] for v in (value, jacobian, slack, multiplier))


CHOSEN = (jnp.ones((1, 1), bool),)


@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_the_set_is_the_cone(seed):
    value, *_ = random_case(seed)
    (found,) = ratio_form.in_ratio_form(CHOSEN, (value,))
    assert (float(found[0, 0, 0]) >= 0.0) == (float(SecondOrder().margin(value)[0, 0, 0]) >= 0.0)
    np.testing.assert_array_equal(found[0, 0, 1:], 0.0)


@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_derivatives_are_those_of_the_number(seed):
    """First ones, and the curvature that the added rows give: y / s times their Gram matrix."""
    value, jacobian, slack, multiplier = random_case(seed)
    plain, curved = ratio_form.jacobians_in_ratio_form(CHOSEN, (value,), (jacobian,), (slack,))
    v, rows = value[0, 0], jacobian[0, 0]
    gradient = jax.grad(height)(v)
    np.testing.assert_allclose(plain[0][0, 0, 0], gradient @ rows, atol=ROUNDING)
    np.testing.assert_array_equal(plain[0][0, 0, 1:], 0.0)
    s, y = float(slack[0, 0, 0]), float(multiplier[0, 0, 0])
    found = y / s * curved[0][0, 0].T @ curved[0][0, 0]
    expected = (
        y / s * jnp.outer(gradient @ rows, gradient @ rows) - y * rows.T @ jax.hessian(height)(v) @ rows
    )
    np.testing.assert_allclose(found, expected, atol=ROUNDING * float(jnp.max(jnp.abs(expected))))
    none = jnp.zeros((0, 1)), jnp.zeros(0), jnp.zeros(0)
    found = ratio_form.cone_multipliers(CHOSEN, Multipliers(*none, (multiplier,)), (value,))
    np.testing.assert_allclose(found.values[0][0, 0], y * gradient, atol=ROUNDING)


@given(st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_slacks_go_back_inside_the_cone(seed):
    """With half of t h: the determinant t^2 - |w|^2 is t times the slack."""
    value, _, slack, _ = random_case(seed)
    (found,) = ratio_form.back_to_cones(CHOSEN, (slack,), (value,))
    head, tail = found[0, 0, 0], found[0, 0, 1:]
    np.testing.assert_array_equal(tail, value[0, 0, 1:])
    np.testing.assert_allclose(head**2 - tail @ tail, value[0, 0, 0] * slack[0, 0, 0], rtol=1e-9)


def test_what_is_not_chosen_stays():
    value, jacobian, slack, multiplier = random_case(0)
    for chosen in ((jnp.zeros((1, 1), bool),), (None,)):
        np.testing.assert_array_equal(ratio_form.in_ratio_form(chosen, (value,))[0], value)
        for same in ratio_form.jacobians_in_ratio_form(chosen, (value,), (jacobian,), (slack,)):
            np.testing.assert_array_equal(same[0], jacobian)
        np.testing.assert_array_equal(ratio_form.back_to_cones(chosen, (slack,), (value,))[0], slack)
        assert not bool(ratio_form.any_of(chosen))
    del multiplier


@pytest.mark.parametrize("head", [0.0, -1.0])
def test_an_apex_gives_no_nan(head):
    """Where t is not positive, nothing is chosen; but a NaN there would spread to the chosen values."""
    value = jnp.array([[[head, 0.3, 0.0, 0.1]]])
    assert np.isfinite(ratio_form.in_ratio_form((jnp.zeros((1, 1), bool),), (value,))[0]).all()
