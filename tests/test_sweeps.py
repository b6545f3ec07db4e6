"""The compiled pass through the intervals against the same pass as JAX, and what it is made of."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import libraries, runge_kutta
from jaxscp.airframes import paper_mav
from jaxscp.dynamics import DoubleIntegrator
from jaxscp.sweeps import Intervals, compiled, native, passes, played, slopes, sweep, tape, tracing

needs_compiled = pytest.mark.skipif(
    not native.available(), reason="the sweep was not compiled: no C++ compiler at installation"
)
ROUNDING = 1e-12  # relative: the sums are those of the pass in JAX, in another order
COUNT = 11  # intervals: a pack and a part of one


class Rigid(eqx.Module):
    """Flight at a cost that is no polynomial."""

    body: eqx.Module

    def __call__(self, state, control):
        u, s = control[:-1], control[-1]
        return s * jnp.append(self.body(state, u), jnp.sqrt(1.0 + jnp.sum(u * u)))


class Line(eqx.Module):
    """A double integrator, which has no parameters."""

    def __call__(self, state, control):
        return control[-1] * jnp.append(DoubleIntegrator(1)(state, control[:-1]), control[0] ** 3)


class Everything(eqx.Module):
    """Every operation that a tape knows, on two states and one control."""

    weight: jax.Array

    def __call__(self, state, control):
        x, y = state
        u, s = control
        trigonometric = jnp.sin(x) * jnp.cos(self.weight[0] * y) - jnp.tanh(u)
        smooth = jnp.exp(-(x**2)) / (1.0 + y**2) + jnp.log(2.0 + u**2) + jnp.sqrt(3.0 + x * y) + x**-2
        bent = jnp.maximum(x, y) + jnp.minimum(y, u) - jnp.abs(x - self.weight[1])
        chosen = jnp.where(x < y, x * u, jnp.where(y >= u, y, x * self.weight[0])) + jnp.where(x > u, u, y)
        order = jnp.where(x <= u, 1.0, x) * jnp.where(x == x, 1.0, y)
        turned = jnp.flip(jnp.stack([x, y])) @ jnp.outer(state, self.weight[:2])
        return s * jnp.stack([trigonometric + bent, smooth + chosen * order, jnp.sum(turned)])


RATES = {
    "rigid body": (Rigid(paper_mav().body), 13, 5),
    "no parameters": (Line(), 2, 2),
    "every operation": (Everything(jnp.array([0.7, 0.4, 1.1])), 2, 2),
}
METHODS = {"fourth order": runge_kutta.CLASSICAL, "sixth order": runge_kutta.SIXTH_ORDER}


def case(rate, states, controls, method, priced):
    """Intervals and what goes in, steps of which every second one is kept."""
    keys = jax.random.split(jax.random.key(0), 2)
    w = 0.3 + jax.random.uniform(keys[0], (COUNT, states + 2 * controls))
    steps = 4
    prices = jax.random.normal(keys[1], (COUNT, steps, method.stages, states + 1)) if priced else None
    return Intervals(rate, states, method, steps, every=2), w, prices


def assert_same(expected, found, tolerance=ROUNDING):
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        size = max(1.0, float(jnp.max(jnp.abs(a))))
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * size)


def uses_compiled(function, *args):
    return native.TARGET in jax.jit(function).lower(*args).as_text()


@needs_compiled
@pytest.mark.parametrize("priced", [False, True], ids=["path", "curvature"])
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("rate", RATES.values(), ids=RATES)
def test_it_is_the_pass_in_jax(rate, method, priced):
    intervals, w, prices = case(*rate, method, priced)
    assert uses_compiled(sweep, intervals, w, prices)
    assert_same(jax.jit(passes.in_jax)(intervals, w, prices), jax.jit(sweep)(intervals, w, prices))


@pytest.mark.parametrize("rate", RATES.values(), ids=RATES)
def test_a_tape_played_by_jax_gives_the_same(rate):
    """As it is on other devices."""
    intervals, w, _ = case(*rate, runge_kutta.CLASSICAL, priced=False)

    def by_tape(intervals, w):
        return played.sweep(intervals, slopes.record(intervals, w.shape[1], priced=False), w)

    assert_same(jax.jit(passes.in_jax)(intervals, w, None), jax.jit(by_tape)(intervals, w))


@needs_compiled
@pytest.mark.parametrize("level", libraries.LEVELS)
def test_every_level_that_runs_here_gives_the_same(level, monkeypatch):
    library = libraries.library(native.STEM, level)
    if library is None:
        pytest.skip(f"{level} is not built for this kind of machine, or it lacks the instructions")
    arguments = case(*RATES["every operation"], runge_kutta.CLASSICAL, True)
    expected = jax.jit(sweep)(*arguments)
    target = f"jaxscp_test_sweep_{level}"
    assert libraries.register(library, native.TARGET, target=target)
    monkeypatch.setattr(native, "TARGET", target)
    monkeypatch.setattr(native, "available", lambda: True)
    jax.clear_caches()
    assert_same(expected, jax.jit(lambda *a: sweep(*a))(*arguments))


@needs_compiled
def test_lanes_have_their_own_parameters_and_do_not_touch():
    """Batched twice, one lane with NaN: packs hold intervals of several lanes."""
    rate, states, controls = RATES["every operation"]
    _, w, prices = case(rate, states, controls, runge_kutta.CLASSICAL, True)
    scales = jnp.array([[1.0, 0.5, 2.0], [0.1, jnp.nan, 1.5]])

    def one(scale):
        scaled = Everything(rate.weight * scale)
        return sweep(Intervals(scaled, states, runge_kutta.CLASSICAL, 4), w * scale, prices)

    found = jax.tree.map(lambda v: v.reshape(6, *v.shape[2:]), jax.jit(jax.vmap(jax.vmap(one)))(scales))
    for lane, scale in enumerate(scales.ravel()):
        alone = jax.jit(one)(scale)
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(found), strict=True):
            np.testing.assert_array_equal(a, b[lane])
    assert not np.isfinite(found.path[4]).any()
    assert np.isfinite(found.path[5]).all()


@needs_compiled
@pytest.mark.parametrize("which", [0, 1])
def test_no_number_stays_none(which):
    """Whichever operand of a maximum or minimum it is."""

    class Bent(eqx.Module):
        def __call__(self, state, control):
            x, y = state
            return jnp.stack([jnp.maximum(x, y), jnp.minimum(x, y), control[0]])

    intervals, w, _ = case(Bent(), 2, 2, runge_kutta.CLASSICAL, False)
    w = w.at[3, which].set(jnp.nan)
    assert uses_compiled(sweep, intervals, w)
    expected, found = (np.isnan(f(intervals, w, None).path) for f in (passes.in_jax, jax.jit(sweep)))
    assert expected[3].sum() == 4  # both states, of both points that are kept
    np.testing.assert_array_equal(found, expected)


@needs_compiled
def test_what_is_no_arithmetic_is_left_to_jax():
    class Solves(eqx.Module):
        def __call__(self, state, control):
            matrix = jnp.eye(2) + 0.1 * jnp.outer(state, state)
            return jnp.append(jnp.linalg.solve(matrix, state), control[0])

    intervals, w, _ = case(Solves(), 2, 2, runge_kutta.CLASSICAL, False)
    assert not uses_compiled(sweep, intervals, w)
    assert_same(passes.in_jax(intervals, w, None), sweep(intervals, w))
    rate, states, controls = RATES["no parameters"]
    intervals, w, _ = case(rate, states, controls, runge_kutta.CLASSICAL, False)
    assert not uses_compiled(sweep, intervals, w.astype(jnp.float32))


@needs_compiled
def test_derivatives_are_those_of_the_pass_in_jax():
    intervals, w, _ = case(*RATES["every operation"], runge_kutta.CLASSICAL, False)

    def measured(through):
        def total(rate, w):
            found = through(eqx.tree_at(lambda i: i.rate, intervals, rate), w, None)
            return jnp.sum(jnp.sin(found.path)) + jnp.sum(found.tangent**2)

        return jax.jit(jax.grad(total, argnums=(0, 1)))(intervals.rate, w)

    assert_same(measured(passes.in_jax), measured(sweep))


def test_only_what_can_be_is_not_zero():
    """The position of a free body moves nothing, and a thrust turns it: the structure of equations (1)-(4)."""
    rate, states, controls = RATES["rigid body"]

    @jax.jit
    def look(rate):
        intervals, w, _ = case(rate, states, controls, runge_kutta.CLASSICAL, False)
        found.append(slopes.record(intervals, w.shape[1], True))
        return 0.0

    found = []
    look(rate)
    entries = {tuple(map(int, at)) for at in found[0].jacobian}
    assert not any(column < 3 for _, column in entries)
    assert {row for row, column in entries if 13 <= column < 17} == {3, 4, 5, 10, 11, 12, 13}
    assert (0, 3) in entries
    assert (0, 4) not in entries
    assert all(row >= column for row, column in found[0].hessian)
    first = compiled.first_inputs(found[0].jacobian, states, w_size := states + 2 * controls)
    assert list(first) == [0, 1, 2, 3, 4, 5, *[6] * 4, *[10] * 3, 13]
    assert w_size == 23


def test_equal_numbers_are_recorded_once():
    def function(v):
        return jnp.stack([v[0] * v[1] + v[2], v[1] * v[0] - v[2], 0.0 * v[0], v[2] * 1.0])

    (outputs,) = tracing.trace(function, (3,)).outputs
    recorded = tape.record(list(outputs), 3)
    assert len(recorded.operations) == 3  # the product is read twice, so that it is not made with a sum
    assert recorded.outputs[3] == 2
    assert list(recorded.constants) == [0.0]


def test_what_no_tape_can_do_is_said():
    with pytest.raises(tracing.CannotTrace, match="erf"):
        tracing.trace(lambda v: jax.scipy.special.erf(v), (2,))
