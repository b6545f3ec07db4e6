"""The GPU's kernel of the pass through intervals without a GPU: run on a CPU thread by thread, and compiled by NVIDIA's
compiler."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends.codegen import launch
from jaxscp.integration import dispatch, in_cuda, in_jax, tableaus
from jaxscp.integration.intervals import Intervals, PathOutputs, without_data
from jaxscp.transcription.discretise import METHOD
from jaxscp.transcription.layout import interval_inputs
from tests.integration.test_dispatch import RATES, Everything, Watched, assert_same, case
from tests.support.flights import random_nodes, short_problem
from tests.support.kernels import as_on_a_gpu, compiled, handler, needs_compiler, needs_nvidia


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """The pass by the kernel of some intervals, with so many columns a thread."""
    monkeypatch.setattr(launch, "TARGET", handler())

    def passed(columns):
        def linear(intervals, w, _):
            found = in_cuda.record(intervals, w.shape[-1], columns)
            return in_cuda.sweep(intervals, found, compiled(found.text, tmp_path), w)

        return linear

    return passed


class Steep(eqx.Module):
    """The greatest of several numbers, which begins with less than any."""

    def __call__(self, state, control):
        return jnp.stack([jnp.max(state * control[0]), jnp.min(state), control[1] * jnp.max(state)])


@needs_compiler
@pytest.mark.parametrize(
    ("rate", "method", "columns"),
    [
        (RATES["rigid body"], tableaus.CLASSICAL, 3),
        (RATES["no parameters"], tableaus.SIXTH_ORDER, 4),
        (RATES["every operation"], tableaus.CLASSICAL, 1),
        ((Steep(), 2, 2), tableaus.CLASSICAL, 2),
    ],
    ids=[*RATES, "steep"],
)
def test_it_is_the_pass_in_jax(rate, method, columns, emulated):
    intervals, w, data = case(*rate, method, order=1, watch=False)
    assert_same(jax.jit(in_jax.linear)(intervals, w, data), jax.jit(emulated(columns))(intervals, w, data))


@needs_compiler
def test_it_is_the_pass_on_a_cpu_of_a_flight(emulated):
    """As the paper's mode linearises it."""
    problem = short_problem()
    w = interval_inputs(problem, random_nodes(problem, 1))
    intervals = Intervals(problem.slope, problem.state_size, METHOD, 10, 10)
    arguments = intervals, w, without_data(intervals, w.shape[0])
    assert_same(eqx.filter_jit(dispatch.linear)(*arguments), eqx.filter_jit(emulated(2))(*arguments))


@needs_compiler
def test_lanes_have_their_own_parameters_and_do_not_touch(emulated):
    """Batched twice; of one lane a parameter is no number, of another an interval's variable."""
    rate, states, controls = RATES["every operation"]
    intervals, w, data = case(rate, states, controls, tableaus.CLASSICAL, order=1, watch=False)
    scales = jnp.array([[1.0, 0.5, 0.8], [0.1, jnp.nan, 0.9]])
    ws = (w * scales[:, :, None, None]).at[1, 1].set(w).at[0, 2, 7, 1].set(jnp.nan)

    def all_by(linear):
        def one(scale, w):
            scaled = eqx.tree_at(lambda i: i.rate, intervals, Everything(rate.weight * scale))
            return linear(scaled, w, data)

        return jax.jit(jax.vmap(jax.vmap(one)))(scales, ws)

    expected, found = all_by(in_jax.linear), all_by(emulated(2))
    assert not np.isfinite(found[0].end[1, 1]).any()
    assert np.isnan(found[1].end[0, 2, 7]).any()
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        good = np.ones((2, 3, w.shape[0]), bool)
        good[1, 1], good[0, 2, 7] = False, False
        assert_same(a[good], b[good])


class Bent(eqx.Module):
    def __call__(self, state, control):
        x, y = state
        return jnp.stack([jnp.maximum(x, y), jnp.minimum(x, y), control[0]])


@needs_compiler
def test_no_number_stays_none(emulated):
    """Whichever operand of a maximum or minimum it is, and in its own interval alone."""
    intervals, w, data = case(Bent(), 2, 2, tableaus.CLASSICAL, order=1, watch=False)
    w = w.at[3, 0].set(jnp.nan).at[5, 1].set(jnp.nan)
    found, _ = jax.jit(emulated(1))(intervals, w, data)
    expected = np.zeros(found.end.shape, bool)
    expected[[3, 5]] = True
    np.testing.assert_array_equal(np.isnan(found.end), expected)


@needs_nvidia
@pytest.mark.parametrize("capability", ["80", "90"])
def test_kernel_compiles(capability):
    intervals, w, _ = case(*RATES["every operation"], tableaus.CLASSICAL, order=1, watch=False)
    image = launch.image(in_cuda.record(intervals, w.shape[1]).text, capability, "the sweep")
    assert image is not None
    assert image.startswith(b"\x7fELF")


@needs_nvidia
def test_a_kernel_that_does_not_compile_is_left_to_jax():
    with pytest.warns(UserWarning, match="sweep's kernel does not compile, and it runs as JAX"):
        assert launch.image("no text of a kernel", "90", "the sweep") is None


def test_a_gpu_runs_the_kernel_and_other_devices_do_not(monkeypatch):
    """As on a machine with a GPU: each device takes its own pass."""
    intervals, w, data = case(*RATES["every operation"], tableaus.CLASSICAL, order=1, watch=False)
    assert not in_cuda.serves(intervals, w)
    as_on_a_gpu(monkeypatch)

    def calls(platform, intervals, w, data):
        traced = jax.jit(jax.vmap(lambda w: dispatch.linear(intervals, w, data))).trace(w[None])
        return launch.TARGET in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda", intervals, w, data)
    assert not calls("cpu", intervals, w, data)
    assert not in_cuda.serves(intervals, w.astype(jnp.float32))
    asked = eqx.tree_at(lambda i: i.watch, intervals, PathOutputs(of_ends=Watched(2).of_ends))
    assert not in_cuda.serves(asked, w)
