"""Cone algebra: each method by its definition, on random points inside and outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.cones.cone import NonNegative, SecondOrder, Zero
from jaxscp.cones.kinds import by_cone

ROUNDING = 1e-9
SHORT = 1e-4 / 16  # the smoothed margin may be short by this much
CONES = {"nonnegative": NonNegative(), "second order": SecondOrder()}
vectors = st.lists(st.floats(-10.0, 10.0), min_size=4, max_size=4).map(np.array)


def inside(cone, v):
    """A point well inside a cone."""
    v = jnp.asarray(v)
    return cone.shift_inside(v, jnp.full(4, 0.5))


def least_margin(cone, v):
    return float(jnp.min(cone.margin(jnp.asarray(v))))


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
@settings(max_examples=25, deadline=None)
@given(v=vectors)
def test_margin_and_violation_agree(cone, v):
    np.testing.assert_allclose(float(cone.violation(jnp.asarray(v))), -least_margin(cone, v), atol=ROUNDING)


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
@settings(max_examples=25, deadline=None)
@given(v=vectors)
def test_a_shifted_point_has_the_margin_asked_for(cone, v):
    assert least_margin(cone, inside(cone, v)) >= 0.5 - ROUNDING


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
@settings(max_examples=25, deadline=None)
@given(v=vectors, direction=vectors)
def test_the_step_length_ends_on_the_boundary(cone, v, direction):
    point = inside(cone, v)
    step = float(cone.step_length(point, jnp.asarray(direction)))
    if step < 1e3:
        scale = 1.0 + step * float(np.abs(direction).max()) + float(jnp.abs(point).max())
        assert abs(least_margin(cone, point + step * direction)) < 1e-6 * scale


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
@settings(max_examples=25, deadline=None)
@given(v=vectors)
def test_the_barrier_gradient_is_minus_the_inverse(cone, v):
    """v o (-grad) = e, for the barrier -log det (halved for a second-order cone)."""
    point = inside(cone, v)
    product = cone.jordan_product(point, -cone.barrier_gradient(point))
    np.testing.assert_allclose(product, cone.identity(4), atol=1e-6)


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
@settings(max_examples=25, deadline=None)
@given(s=vectors, y=vectors)
def test_the_scaling_maps_the_multiplier_to_the_slack(cone, s, y):
    """W^2 y = s, and the parts of W^-2 add up to it."""
    s, y = inside(cone, s), inside(cone, y)
    w = cone.scaling(s, y)
    np.testing.assert_allclose(w.square(y), s, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(w.inverse_square(s), y, rtol=1e-6, atol=1e-6)
    diagonal, vector = w.inverse_square_parts()
    product = diagonal * s + (0.0 if vector is None else vector * jnp.dot(vector, s))
    np.testing.assert_allclose(product, y, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("cone", [*CONES.values(), Zero()], ids=[*CONES, "zero"])
def test_the_margins_jacobian_is_its_derivative(cone):
    values, jacobian = (
        jax.random.normal(jax.random.key(0), (4,)),
        jax.random.normal(jax.random.key(1), (4, 3)),
    )
    values = values - (
        3.0 if isinstance(cone, Zero) else 0.0
    )  # -|v| has the sign's slope; these are negative
    found = cone.margin_jacobian(values, jacobian)
    np.testing.assert_allclose(found, jax.jacfwd(cone.margin)(values) @ jacobian, atol=ROUNDING)


@pytest.mark.parametrize("cone", [*CONES.values(), Zero()], ids=[*CONES, "zero"])
def test_an_inactive_value_satisfies_the_cone(cone):
    value = cone.inactive_value(jnp.arange(4.0))
    assert float(cone.violation(value)) <= 0.0


@pytest.mark.parametrize("cone", CONES.values(), ids=CONES)
def test_tightened_values_bound_a_parabola_between_the_points(cone):
    """A condition that dips between points is satisfied there if its tightened values are feasible at the points."""
    tau = jnp.linspace(0.0, 1.0, 6)
    dip = 0.3 * (tau - 0.37) ** 2 * 4.0
    values = jnp.stack([2.0 + dip, 1.0 - dip, 0.5 * dip], axis=1)
    rows = cone.condition_rows(3)
    parts = [values[:, k : k + rows] for k in range(0, 3, rows)]
    for part in parts:
        second = jnp.diff(part, n=2, axis=0)
        second = jnp.concatenate([second[:1], second, second[-1:]])
        tight = cone.tighten(part, second, jnp.ones(6))
        assert float(jnp.max(cone.margin(tight) - cone.margin(part))) <= SHORT
        np.testing.assert_array_equal(cone.tighten(part, second, jnp.zeros(6)), part)


def test_positions_are_sorted_by_the_kind_of_cone():
    assert by_cone([SecondOrder(), Zero(), NonNegative(), SecondOrder()]) == ([1], [2], [0, 3])
