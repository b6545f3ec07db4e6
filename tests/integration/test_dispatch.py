"""The compiled pass through the intervals against the same pass as JAX, and what it is made of."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import libraries
from jaxscp.backends.codegen import functions, tape, tracing
from jaxscp.dynamics.airframes import paper_mav
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.integration import dispatch, in_cpp, in_jax, in_tape, native, tableaus
from jaxscp.integration.intervals import IntervalData, Intervals, OutputGroup, PathOutputs, without_data
from jaxscp.transcription.layout import interval_inputs
from jaxscp.transcription.shooting import Grid, given, intervals_of
from tests.support.flights import random_nodes, short_problem

needs_compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the sweep was not compiled: no C++ compiler at installation"
)
ROUNDING = 1e-12  # relative: the sums are those of the pass in JAX, in another order
BENT = 1e-10  # of a flight: a margin's curvature is that of a corner rounded to a tenth of a millimetre
COUNT = 19  # intervals: a pack and a part of one


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
PASSES = {"outcomes": 0, "linear": 1, "curved": 2}


def neighbours(values, keep):
    """A margin for each row, by the row's values at the points beside it."""
    beside = jnp.concatenate([values[1:], values[:1]]) * values
    return values - keep[:, None] * jnp.sqrt(1.0 + beside * beside)


class Watched(eqx.Module):
    """Rows at the points, and rows of the interval's variables."""

    states: int = eqx.field(static=True)

    def at_point(self, state, controls, data):
        weights, limit = jax.tree.map(lambda v: v.astype(state.dtype), data)
        rows = [
            jnp.dot(weights, state[:2]) * controls[-1],
            state[0] * state[1],
            limit,
            state[1] - controls[0],
        ]
        return jnp.stack([*rows, jnp.maximum(state[0], limit) ** 2])

    def of_ends(self, w, data):
        return jnp.stack([data[0] * w[0] * w[self.states], w[-1] ** 3, data[1]])


def watch_of(states):
    """Two rows have a margin together, three each their own."""
    watched = Watched(states)
    return PathOutputs(
        watched.at_point, watched.of_ends, (OutputGroup(2, 2, neighbours), OutputGroup(3, 1, neighbours))
    )


def case(rate, states, controls, method, order=2, watch=True):
    """A pass and what goes in, with a point after every second step."""
    keys = jax.random.split(jax.random.key(0), 5)
    w = 0.3 + jax.random.uniform(keys[0], (COUNT, states + 2 * controls))
    if watch:
        intervals = Intervals(rate, states, method, 6, 2, watch_of(states))
        point = jax.random.normal(keys[1], (COUNT, 2)), jax.random.normal(keys[2], (COUNT,))
        data = IntervalData(
            point, jax.random.normal(keys[3], (COUNT, 2)), jnp.ones((COUNT, 4)).at[0, 0].set(0.0)
        )
    else:
        intervals = Intervals(rate, states, method, 4, 4)
        data = without_data(intervals, COUNT)
    if order < 2:
        return intervals, w, data
    like = jax.eval_shape(in_jax.outcomes, intervals, w, data)
    prices = jax.tree.map(lambda v: jnp.asarray(np.random.default_rng(1).standard_normal(v.shape)), like)
    return intervals, w, data, prices


def assert_same(expected, found, tolerance=ROUNDING):
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        size = float(jnp.max(jnp.abs(a), initial=1.0))
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * size)


def uses_compiled(function, *args):
    return native.TARGET in jax.jit(function).lower(*args).as_text()


@needs_compiled
@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("outcomes", tableaus.CLASSICAL),
        ("linear", tableaus.CLASSICAL),
        ("curved", tableaus.SIXTH_ORDER),
    ],
    ids=PASSES,
)
@pytest.mark.parametrize("rate", RATES.values(), ids=RATES)
def test_it_is_the_pass_in_jax(rate, name, method):
    arguments = case(*rate, method, PASSES[name])
    ours = getattr(dispatch, name)
    assert uses_compiled(ours, *arguments)
    assert_same(jax.jit(getattr(in_jax, name))(*arguments), jax.jit(ours)(*arguments))


@needs_compiled
@pytest.mark.parametrize(
    ("name", "grid"),
    [
        ("outcomes", Grid()),
        ("linear", Grid(points=3, steps=2)),
        pytest.param("curved", Grid(), marks=pytest.mark.slow),  # as JAX it takes half a minute to compile
    ],
)
def test_it_is_the_pass_in_jax_of_a_flight(name, grid):
    """With everything that a scenario may ask for."""
    problem, random = short_problem(everything=True), np.random.default_rng(0)
    z = random_nodes(problem, 1)

    def through(module):
        def passed(problem, z, *prices):
            asked = intervals_of(problem, grid), interval_inputs(problem, z), given(problem, grid)
            return getattr(module, name)(*asked, *prices)

        return passed

    prices = ()
    if name == "curved":
        like = jax.eval_shape(lambda p, z: through_outcomes(p, z, grid), problem, z)
        prices = (jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), like),)
    assert uses_compiled(through(dispatch), problem, z, *prices)
    expected = jax.jit(through(in_jax))(problem, z, *prices)
    assert_same(expected, jax.jit(through(dispatch))(problem, z, *prices), tolerance=BENT)


def through_outcomes(problem, z, grid):
    return in_jax.outcomes(intervals_of(problem, grid), interval_inputs(problem, z), given(problem, grid))


@pytest.mark.parametrize("rate", RATES.values(), ids=RATES)
def test_a_tape_played_by_jax_gives_the_same(rate):
    """As it is on other devices."""
    intervals, w, data = case(*rate, tableaus.CLASSICAL, order=1, watch=False)
    assert_same(jax.jit(in_jax.linear)(intervals, w, data), jax.jit(in_tape.linear)(intervals, w))


def test_on_other_devices_what_is_asked_of_the_ends_alone_is_not_forgotten(monkeypatch):
    rate, states, controls = RATES["no parameters"]
    intervals, w, data = case(rate, states, controls, tableaus.CLASSICAL, order=1, watch=False)
    asked = eqx.tree_at(lambda i: i.watch, intervals, PathOutputs(of_ends=Watched(states).of_ends))
    data = IntervalData((), jnp.ones((COUNT, 2)), data.keep)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(libraries.Library, "available", lambda _: False)
    expected = jax.eval_shape(in_jax.linear, asked, w, data)
    found = jax.eval_shape(lambda *a: dispatch.linear(*a), asked, w, data)
    assert expected[0].ends.shape == (COUNT, 3)
    assert jax.tree.map(lambda v: v.shape, expected) == jax.tree.map(lambda v: v.shape, found)


@needs_compiled
def test_every_level_that_runs_here_gives_the_same(at_level):
    arguments = case(*RATES["every operation"], tableaus.CLASSICAL)
    expected = jax.jit(dispatch.curved)(*arguments)
    at_level(native, "TARGET")
    jax.clear_caches()
    assert_same(expected, jax.jit(lambda *a: dispatch.curved(*a))(*arguments))


@needs_compiled
def test_lanes_have_their_own_parameters_and_do_not_touch():
    """Batched twice, one lane with NaN: packs hold intervals of several lanes."""
    rate, states, controls = RATES["every operation"]
    intervals, w, data, prices = case(rate, states, controls, tableaus.CLASSICAL)
    scales = jnp.array([[1.0, 0.5, 2.0], [0.1, jnp.nan, 1.5]])

    def one(scale):
        scaled = eqx.tree_at(lambda i: i.rate, intervals, Everything(rate.weight * scale))
        return dispatch.curved(scaled, w * scale, data, prices)

    found = jax.tree.map(lambda v: v.reshape(6, *v.shape[2:]), jax.jit(jax.vmap(jax.vmap(one)))(scales))
    for lane, scale in enumerate(scales.ravel()):
        alone = jax.jit(one)(scale)
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(found), strict=True):
            np.testing.assert_array_equal(a, b[lane])
    assert not np.isfinite(found[0].end[4]).any()
    assert np.isfinite(found[2][5]).all()


@needs_compiled
@pytest.mark.parametrize("which", [0, 1])
def test_no_number_stays_none(which):
    """Whichever operand of a maximum or minimum it is."""

    class Bent(eqx.Module):
        def __call__(self, state, control):
            x, y = state
            return jnp.stack([jnp.maximum(x, y), jnp.minimum(x, y), control[0]])

    intervals, w, data = case(Bent(), 2, 2, tableaus.CLASSICAL, order=0, watch=False)
    w = w.at[3, which].set(jnp.nan)
    assert uses_compiled(dispatch.outcomes, intervals, w, data)
    expected, found = (np.isnan(jax.jit(m.outcomes)(intervals, w, data).end) for m in (in_jax, dispatch))
    assert expected[3].all()
    np.testing.assert_array_equal(found, expected)


class Solves(eqx.Module):
    """No arithmetic alone."""

    def __call__(self, state, control):
        matrix = jnp.eye(2) + 0.1 * jnp.outer(state, state)
        return jnp.append(jnp.linalg.solve(matrix, state), control[0])


@needs_compiled
@pytest.mark.parametrize("name", ["outcomes", "linear"])
def test_what_is_no_arithmetic_is_left_to_jax(name):
    order = PASSES[name]
    ours, theirs = getattr(dispatch, name), getattr(in_jax, name)
    by_rate = case(Solves(), 2, 2, tableaus.CLASSICAL, order)
    rate, states, controls = RATES["no parameters"]
    intervals, w, data, *prices = case(rate, states, controls, tableaus.CLASSICAL, order)
    whole = jax.tree.map(lambda v: v.astype(int), data.point)
    for arguments in (by_rate, (intervals, w, IntervalData(whole, data.ends, data.keep), *prices)):
        assert not uses_compiled(ours, *arguments)
        assert_same(jax.jit(theirs)(*arguments), jax.jit(ours)(*arguments))
    assert uses_compiled(ours, intervals, w, data, *prices)
    single = jax.tree.map(lambda v: v.astype(jnp.float32), (w, data, *prices))
    assert not uses_compiled(ours, intervals, *single)


@needs_compiled
@pytest.mark.parametrize("name", ["outcomes", "linear"])
def test_derivatives_are_those_of_the_pass_in_jax(name):
    intervals, w, data = case(*RATES["every operation"], tableaus.CLASSICAL, order=1)

    def measured(module):
        def total(rate, w, data):
            found = getattr(module, name)(eqx.tree_at(lambda i: i.rate, intervals, rate), w, data)
            return sum(jnp.sum(jnp.sin(v)) for v in jax.tree.leaves(found))

        return jax.jit(jax.grad(total, argnums=(0, 1, 2)))(intervals.rate, w, data)

    assert_same(measured(in_jax), measured(dispatch))


def test_only_what_can_be_is_not_zero():
    """The position of a free body moves nothing, and a thrust turns it: the structure of equations (1)-(4)."""
    rate, states, controls = RATES["rigid body"]

    @jax.jit
    def look(rate):
        found.append(functions.record(lambda a: rate(a[:states], a[states:]), states + controls, (), order=2))
        return 0.0

    found = []
    look(rate)
    entries = {tuple(map(int, at)) for at in found[0].jacobian}
    assert not any(column < 3 for _, column in entries)
    assert {row for row, column in entries if 13 <= column < 17} == {3, 4, 5, 10, 11, 12, 13}
    assert (0, 3) in entries
    assert (0, 4) not in entries
    assert all(row >= column for row, column in found[0].hessian)
    first = in_cpp.first_inputs(found[0].jacobian, states, w_size := states + 2 * controls)
    assert list(first) == [0, 1, 2, 3, 4, 5, *[6] * 4, *[10] * 3, 13]
    assert w_size == 23


def test_what_is_of_one_kind_is_played_in_runs():
    """And still after what it is made of."""

    def function(v):
        return jnp.stack([v[0] * v[1] - v[2], (v[0] - v[1]) * v[2], (v[1] - v[2]) * v[0] * v[0]])

    (outputs,) = tracing.trace(function, (3,)).outputs
    recorded = tape.record(list(outputs), 3)
    codes = [int(code) for code in recorded.operations[:, 0]]
    runs = 1 + sum(a != b for a, b in itertools.pairwise(codes))
    assert runs <= 3
    v = [jnp.array(x) for x in (1.1, 0.3, -2.0)]
    np.testing.assert_allclose(in_tape.play(recorded, v, jnp.zeros(0)), function(jnp.stack(v)), rtol=ROUNDING)


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
