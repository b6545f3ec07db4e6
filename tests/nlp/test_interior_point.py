"""The interior point on the nonlinear program: steps that go to and fro."""

import jax.numpy as jnp
import numpy as np

from jaxscp.nlp.interior_point import next_damping


def newton(step, start, steps, damped):
    """Iterates of Newton's method for one unknown."""
    x, damping, last, found = jnp.full((1, 1), start), jnp.ones(()), jnp.zeros((1, 1)), []
    for _ in range(steps):
        if damped:
            damping = next_damping(damping, last, step(x))
        last = damping * step(x)
        x = x + last
        found.append(float(x[0, 0]))
    return np.array(found)


def test_newton_steps_that_go_to_and_fro_are_damped_until_they_converge():
    """The root of x / sqrt(1 + x^2): from 1, Newton's method goes to -1 and back."""
    step = lambda x: -x * (1.0 + x * x)  # noqa: E731
    np.testing.assert_allclose(newton(step, 1.0, 10, damped=False), [-1.0, 1.0] * 5, atol=1e-12)
    found = newton(step, 1.0, 20, damped=True)
    np.testing.assert_allclose(found[-1], 0.0, atol=1e-12)


def test_steps_that_converge_are_not_damped():
    """The square root of two, from both sides."""
    step = lambda x: (2.0 / x - x) / 2.0  # noqa: E731
    for start in (1.0, 3.0):
        found = [newton(step, start, 6, damped) for damped in (False, True)]
        np.testing.assert_array_equal(*found)
