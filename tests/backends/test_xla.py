"""Compiler options: results do not change, and unknown options are left out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import xla

ROUNDING = 1e-13


def power(exponent, v):
    return jnp.cumsum(jnp.sin(v)) ** exponent


@pytest.fixture
def compiled():
    return xla.jit_with_options(power, static_argnums=0)


def test_results_are_those_of_the_function_at_top_level_and_traced(compiled):
    v = jnp.linspace(0.0, 1.0, 7)
    np.testing.assert_allclose(compiled(3, v), power(3, v), rtol=ROUNDING)
    np.testing.assert_allclose(jax.jit(lambda v: compiled(2, v))(v), power(2, v), rtol=ROUNDING)
    in_jit = jax.jit(lambda: compiled(2, np.ones(3)))()
    np.testing.assert_allclose(in_jit, power(2, jnp.ones(3)), rtol=ROUNDING)
    batch = jax.vmap(lambda v: compiled(2, v))(jnp.stack([v, 2.0 * v]))
    np.testing.assert_allclose(batch, [power(2, v), power(2, 2.0 * v)], rtol=ROUNDING)
    np.testing.assert_allclose(jax.grad(lambda v: compiled(2, v)[0])(v)[0], np.sin(2 * v[0]), atol=ROUNDING)


def test_an_option_that_this_version_rejects_is_left_out(monkeypatch):
    known = {"xla_cpu_parallel_codegen_split_count": 8}
    monkeypatch.setattr(xla, "CPU_OPTIONS", {"xla_cpu_no_such_option": True} | known)
    xla._options.cache_clear()
    try:
        assert xla.compiler_options() == known
        assert float(xla.jit_with_options(power, static_argnums=0)(1, jnp.zeros(1))[0]) == 0.0
    finally:
        xla._options.cache_clear()


def test_a_caller_may_add_options_of_its_own():
    xla.compiler_options()["xla_of_my_own"] = True
    assert "xla_of_my_own" not in xla.compiler_options()
