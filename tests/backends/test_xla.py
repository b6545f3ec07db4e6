"""Programs that are compiled quickly where they stand alone, and as part of others where they do not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import xla

ROUNDING = 1e-13


def power(exponent, v):
    return jnp.cumsum(jnp.sin(v)) ** exponent


@pytest.fixture
def quick():
    return xla.jit_with_options(power, static_argnums=0)


def test_is_the_function_wherever_it_is_called(quick):
    v = jnp.linspace(0.0, 1.0, 7)
    np.testing.assert_allclose(quick(3, v), power(3, v), rtol=ROUNDING)
    np.testing.assert_allclose(jax.jit(lambda v: quick(2, v))(v), power(2, v), rtol=ROUNDING)
    np.testing.assert_allclose(jax.jit(lambda: quick(2, np.ones(3)))(), power(2, jnp.ones(3)), rtol=ROUNDING)
    lanes = jax.vmap(lambda v: quick(2, v))(jnp.stack([v, 2.0 * v]))
    np.testing.assert_allclose(lanes, [power(2, v), power(2, 2.0 * v)], rtol=ROUNDING)
    np.testing.assert_allclose(jax.grad(lambda v: quick(2, v)[0])(v)[0], np.sin(2 * v[0]), atol=ROUNDING)


def test_an_option_that_this_version_does_not_know_is_left_out(monkeypatch):
    monkeypatch.setattr(xla, "QUICKLY", {"xla_cpu_no_such_option": True})
    xla.options.cache_clear()
    try:
        assert xla.options() == {}
        assert float(xla.jit_with_options(power, static_argnums=0)(1, jnp.zeros(1))[0]) == 0.0
    finally:
        xla.options.cache_clear()
