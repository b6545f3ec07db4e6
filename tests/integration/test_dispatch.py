"""Integration in C++ and by tapes against integration in JAX."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import libraries
from jaxscp.integration import dispatch, in_jax, in_tape, native, tableaus
from jaxscp.integration.intervals import IntervalData, PathOutputs
from jaxscp.transcription.interval_inputs import integration_inputs
from jaxscp.transcription.shooting import Grid, interval_data, intervals_of
from tests.support.flights import random_nodes, short_problem
from tests.support.interval_problems import (
    COUNT,
    ORDERS,
    RATES,
    EveryOperation,
    Rows,
    assert_same,
    random_case,
)

needs_compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the C++ was not compiled: no compiler at installation"
)
SMOOTHED = 1e-10  # of a landing: a margin's Hessian is large, as its corner is rounded at 0.1 mm


def uses_compiled(function, *args):
    return native.TARGET in jax.jit(function).lower(*args).as_text()


@needs_compiled
@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("evaluate", tableaus.CLASSICAL),
        ("linearise", tableaus.CLASSICAL),
        ("linearise_with_hessian", tableaus.SIXTH_ORDER),
    ],
    ids=ORDERS,
)
@pytest.mark.parametrize(
    "rate",
    [
        pytest.param(rate, id=name, marks=[pytest.mark.slow] if name == "rigid body" else [])
        for name, rate in RATES.items()
    ],
)
def test_compiled_equals_jax(rate, name, method):
    arguments = random_case(*rate, method, ORDERS[name])
    ours = getattr(dispatch, name)
    assert uses_compiled(ours, *arguments)
    assert_same(jax.jit(getattr(in_jax, name))(*arguments), jax.jit(ours)(*arguments))


@needs_compiled
@pytest.mark.parametrize(
    ("name", "grid"),
    [
        pytest.param("evaluate", Grid(), marks=pytest.mark.slow),
        pytest.param("linearise", Grid(subintervals=3, steps=2), marks=pytest.mark.slow),
        # in JAX this takes half a minute to compile
        pytest.param("linearise_with_hessian", Grid(), marks=pytest.mark.nightly),
    ],
)
def test_compiled_equals_jax_on_a_landing_with_every_constraint(name, grid):
    problem, random = short_problem(everything=True), np.random.default_rng(0)
    z = random_nodes(problem, 1)

    def by(module):
        def function(problem, z, *multipliers):
            arguments = (
                intervals_of(problem, grid),
                integration_inputs(problem, z),
                interval_data(problem, grid),
            )
            return getattr(module, name)(*arguments, *multipliers)

        return function

    multipliers = ()
    if name == "linearise_with_hessian":
        like = jax.eval_shape(lambda p, z: outputs_in_jax(p, z, grid), problem, z)
        multipliers = (jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), like),)
    assert uses_compiled(by(dispatch), problem, z, *multipliers)
    expected = jax.jit(by(in_jax))(problem, z, *multipliers)
    assert_same(expected, jax.jit(by(dispatch))(problem, z, *multipliers), tolerance=SMOOTHED)


def outputs_in_jax(problem, z, grid):
    return in_jax.evaluate(
        intervals_of(problem, grid), integration_inputs(problem, z), interval_data(problem, grid)
    )


@pytest.mark.parametrize(
    "rate",
    [
        pytest.param(rate, id=name, marks=[pytest.mark.nightly] if name == "rigid body" else [])
        for name, rate in RATES.items()
    ],
)
def test_tape_evaluated_by_jax_equals_jax(rate):
    """The implementation of GPUs without a kernel."""
    intervals, w, data = random_case(*rate, tableaus.CLASSICAL, order=1, outputs=False)
    assert_same(jax.jit(in_jax.linearise)(intervals, w, data), jax.jit(in_tape.linearise)(intervals, w))


def test_other_devices_evaluate_functions_of_w(monkeypatch):
    """Without outputs at points: such intervals are not empty."""
    rate, states, controls = RATES["no parameters"]
    intervals, w, data = random_case(rate, states, controls, tableaus.CLASSICAL, order=1, outputs=False)
    outputs = PathOutputs(at_ends=Rows(states).at_ends)
    with_ends = eqx.tree_at(lambda i: i.path_outputs, intervals, outputs)
    data = IntervalData((), jnp.ones((COUNT, 2)), data.margin_mask)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(libraries.Library, "available", lambda _: False)
    expected = jax.eval_shape(in_jax.linearise, with_ends, w, data)
    found = jax.eval_shape(lambda *a: dispatch.linearise(*a), with_ends, w, data)
    assert expected[0].ends.shape == (COUNT, 3)
    assert jax.tree.map(lambda v: v.shape, expected) == jax.tree.map(lambda v: v.shape, found)


@pytest.fixture(scope="module")
def best_level():
    """Arguments, and the Hessians by the library that the package itself would load."""
    arguments = random_case(*RATES["every operation"], tableaus.CLASSICAL)
    return arguments, jax.jit(dispatch.linearise_with_hessian)(*arguments)


@needs_compiled
def test_every_instruction_set_gives_the_same(best_level, at_level):
    arguments, expected = best_level
    at_level(native, "TARGET")
    jax.clear_caches()
    found = jax.jit(lambda *a: dispatch.linearise_with_hessian(*a))(*arguments)
    assert_same(expected, found)


@needs_compiled
def test_batch_elements_have_their_own_parameters_and_share_no_nan():
    """Batched twice, one element with NaN: registers hold intervals of several elements."""
    rate, states, controls = RATES["every operation"]
    intervals, w, data, multipliers = random_case(rate, states, controls, tableaus.CLASSICAL)
    scales = jnp.array([[1.0, 0.5, 2.0], [0.1, jnp.nan, 1.5]])

    def one(scale):
        scaled = eqx.tree_at(lambda i: i.rate, intervals, EveryOperation(rate.weight * scale))
        return dispatch.linearise_with_hessian(scaled, w * scale, data, multipliers)

    found = jax.tree.map(lambda v: v.reshape(6, *v.shape[2:]), jax.jit(jax.vmap(jax.vmap(one)))(scales))
    for element, scale in enumerate(scales.ravel()):
        alone = jax.jit(one)(scale)
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(found), strict=True):
            np.testing.assert_array_equal(a, b[element])
    assert not np.isfinite(found[0].end[4]).any()
    assert np.isfinite(found[2][5]).all()


@needs_compiled
@pytest.mark.parametrize("which", [0, 1])
def test_nan_in_either_operand_of_a_maximum_or_minimum_gives_nan(which):
    class Kinked(eqx.Module):
        def __call__(self, state, control):
            x, y = state
            return jnp.stack([jnp.maximum(x, y), jnp.minimum(x, y), control[0]])

    intervals, w, data = random_case(Kinked(), 2, 2, tableaus.CLASSICAL, order=0, outputs=False)
    w = w.at[3, which].set(jnp.nan)
    assert uses_compiled(dispatch.evaluate, intervals, w, data)
    expected, found = (np.isnan(jax.jit(m.evaluate)(intervals, w, data).end) for m in (in_jax, dispatch))
    assert expected[3].all()
    np.testing.assert_array_equal(found, expected)


class LinearSolve(eqx.Module):
    """A rate that is not arithmetic alone."""

    def __call__(self, state, control):
        matrix = jnp.eye(2) + 0.1 * jnp.outer(state, state)
        return jnp.append(jnp.linalg.solve(matrix, state), control[0])


@needs_compiled
@pytest.mark.parametrize("name", ["evaluate", pytest.param("linearise", marks=pytest.mark.slow)])
def test_jax_takes_functions_that_are_not_float64_arithmetic(name):
    order = ORDERS[name]
    ours, theirs = getattr(dispatch, name), getattr(in_jax, name)
    by_rate = random_case(LinearSolve(), 2, 2, tableaus.CLASSICAL, order)
    rate, states, controls = RATES["no parameters"]
    intervals, w, data, *multipliers = random_case(rate, states, controls, tableaus.CLASSICAL, order)
    integers = jax.tree.map(lambda v: v.astype(int), data.point)
    by_data = intervals, w, IntervalData(integers, data.ends, data.margin_mask), *multipliers
    for arguments in (by_rate, by_data):
        assert not uses_compiled(ours, *arguments)
        assert_same(jax.jit(theirs)(*arguments), jax.jit(ours)(*arguments))
    assert uses_compiled(ours, intervals, w, data, *multipliers)
    single = jax.tree.map(lambda v: v.astype(jnp.float32), (w, data, *multipliers))
    assert not uses_compiled(ours, intervals, *single)


@needs_compiled
@pytest.mark.parametrize("name", ["evaluate", pytest.param("linearise", marks=pytest.mark.slow)])
def test_derivatives_are_those_of_jax(name):
    intervals, w, data = random_case(*RATES["every operation"], tableaus.CLASSICAL, order=1)

    def gradient(module):
        def total(rate, w, data):
            found = getattr(module, name)(eqx.tree_at(lambda i: i.rate, intervals, rate), w, data)
            return sum(jnp.sum(jnp.sin(v)) for v in jax.tree.leaves(found))

        return jax.jit(jax.grad(total, argnums=(0, 1, 2)))(intervals.rate, w, data)

    assert_same(gradient(in_jax), gradient(dispatch))
