"""Algebra of stacked second-order cones: scalings, Jordan products, steps to the boundary."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.cones import second_order

numbers = st.floats(-3.0, 3.0)
inside = st.tuples(st.floats(1e-3, 5.0), numbers, numbers, numbers).map(
    lambda v: jnp.array([[v[0] + float(np.linalg.norm(v[1:])), *v[1:]]])
)


@settings(deadline=None, max_examples=40)
@given(inside, inside)
def test_scaling_maps_both_points_to_one(s, y):
    """W y = W^-1 s, W^2 y = s, and the Jordan division undoes the product."""
    w = second_order.second_order_scaling(s, y)
    size = float(jnp.max(jnp.abs(s)) + jnp.max(jnp.abs(y)))
    np.testing.assert_allclose(w.apply(y), w.apply_inverse(s), atol=1e-7 * size)
    np.testing.assert_allclose(w.square(y), s, atol=1e-6 * size)
    np.testing.assert_allclose(w.inverse_square(w.square(y)), y, atol=1e-5 * size)
    np.testing.assert_allclose(
        second_order.jordan_divide(s, second_order.jordan_product(s, y)), y, atol=1e-6 * size
    )


@settings(deadline=None, max_examples=40)
@given(inside, st.tuples(numbers, numbers, numbers, numbers))
def test_step_ends_on_the_boundary(point, direction):
    direction = jnp.array([direction])
    step = float(second_order.step_to_boundary(point, direction)[0])
    before, after = (point + fraction * min(step, 1e3) * direction for fraction in (0.999, 1.001))
    assert float(second_order.determinant(before)[0]) > 0
    if step < 1e3:
        assert float(second_order.determinant(after)[0]) < 0 or float(after[0, 0]) < 0
