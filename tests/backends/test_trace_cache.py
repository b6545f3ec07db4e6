"""Traces that are made once: they depend on structure and constants, and keep no tracer of another trace."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends.codegen import trace_cache
from jaxscp.backends.codegen.trace_cache import traced_once


class Line(eqx.Module):
    slope: jax.Array | np.ndarray
    name: object = eqx.field(static=True, default="line")


@pytest.fixture(autouse=True)
def empty(monkeypatch):
    """A cache of the test's own."""
    monkeypatch.setattr(trace_cache, "_TRACES", {})


class Counted:
    """A function of a line and a factor that notes its calls."""

    def __init__(self):
        self.calls = 0

    def __call__(self, line, factor):
        self.calls += 1
        return f"{line.name} of {line.slope.shape}", {"scaled": factor * line.slope}


def at(counted, factor=2.0, name="line"):
    """The scaled slope, in a trace of its own."""

    @jax.jit
    def scaled(slope):
        found, arrays = traced_once(counted, Line(slope, name), factor)
        assert found == f"{name} of {slope.shape}"
        return arrays["scaled"]

    return scaled


def test_one_trace_serves_other_values():
    counted = Counted()
    for values in ([1.0, 2.0], [5.0, -3.0]):
        slope = jnp.array(values)
        np.testing.assert_array_equal(at(counted)(slope), 2.0 * slope)
    assert counted.calls == 1


def test_other_shapes_structures_and_options_are_traced_anew():
    counted = Counted()
    one = jnp.ones(2)
    np.testing.assert_array_equal(at(counted)(one), 2.0 * one)
    np.testing.assert_array_equal(at(counted)(jnp.ones(3)), 2.0 * jnp.ones(3))
    np.testing.assert_array_equal(at(counted, 3.0)(one), 3.0 * one)
    np.testing.assert_array_equal(at(counted, name="other")(one), 2.0 * one)
    assert counted.calls == 4


def test_one_trace_serves_batches_and_derivatives():
    counted, slopes = Counted(), jnp.arange(6.0).reshape(3, 2)
    scaled = lambda slope: traced_once(counted, Line(slope), 2.0)[1]["scaled"]  # noqa: E731
    np.testing.assert_array_equal(jax.vmap(scaled)(slopes), 2.0 * slopes)
    np.testing.assert_array_equal(jax.grad(lambda s: scaled(s).sum())(slopes[0]), [2.0, 2.0])
    np.testing.assert_array_equal(jax.jit(scaled)(slopes[0]), 2.0 * slopes[0])
    assert counted.calls == 1


@pytest.mark.parametrize("array", [np.array, jnp.array])
def test_arrays_that_are_no_tracers_are_constants(array):
    counted = Counted()
    for value, calls in ((1.0, 1), (4.0, 2), (1.0, 2)):
        _, arrays = traced_once(counted, Line(array([value])), 2.0)
        assert arrays["scaled"].tolist() == [2.0 * value]
        assert counted.calls == calls


def test_derivatives_and_batches_pass_through():
    scaled = at(Counted())
    slopes = jnp.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(jax.vmap(scaled)(slopes), 2.0 * slopes)
    np.testing.assert_array_equal(jax.grad(lambda s: scaled(s).sum())(slopes[0]), [2.0, 2.0])


def test_a_trace_that_closes_over_a_tracer_is_not_kept():
    @jax.jit
    def closing(hidden, slope):
        function = lambda line: (None, hidden * line.slope)  # noqa: E731
        return traced_once(function, Line(slope))[1]

    assert closing(jnp.array(3.0), jnp.array([2.0])).tolist() == [6.0]
    assert not trace_cache._TRACES


class Unhashable:
    __hash__ = None


@pytest.mark.parametrize("leaf", [Unhashable(), jax.random.key(0)], ids=["object", "random key"])
def test_a_leaf_that_cannot_be_a_key_is_traced_each_time(leaf):
    counted = Counted()
    function = lambda tree, factor: counted(tree[0], factor)  # noqa: E731
    for _ in range(2):
        assert traced_once(function, (Line(jnp.ones(1)), leaf), 2.0)[1]["scaled"].tolist() == [2.0]
    assert counted.calls == 2
    assert not trace_cache._TRACES


def test_the_oldest_trace_is_forgotten(monkeypatch):
    monkeypatch.setattr(trace_cache, "ENTRIES", 2)
    counted = Counted()
    for factor in (1.0, 2.0, 3.0):
        traced_once(counted, Line(jnp.ones(1)), factor)
    assert len(trace_cache._TRACES) == 2
    traced_once(counted, Line(jnp.ones(1)), 3.0)
    assert counted.calls == 3
    traced_once(counted, Line(jnp.ones(1)), 1.0)
    assert counted.calls == 4
