"""The CUDA kernel without a GPU: compiled for a CPU, where threads run one after another, and compiled by NVRTC."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import launch
from jaxscp.integration import dispatch, in_cuda, in_jax, native, tableaus
from jaxscp.integration.intervals import Intervals, PathOutputs, without_data
from jaxscp.transcription.discretise import METHOD
from jaxscp.transcription.interval_inputs import integration_inputs
from tests.support.flights import random_nodes, short_problem
from tests.support.interval_problems import RATES, EveryOperation, Rows, assert_same, random_case
from tests.support.kernels import as_on_a_gpu, compiled, handler, needs_compiler, needs_nvidia


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """``linearise`` by the kernel, with so many columns in a thread."""
    monkeypatch.setattr(native, "LIBRARY", native.LIBRARY._replace(on_gpu=handler()))

    def with_columns(columns):
        def linearise(intervals, w, _):
            found = in_cuda.record(intervals, w.shape[-1], columns)
            return in_cuda.linearise(intervals, found, compiled(found.text, tmp_path), w)

        return linearise

    return with_columns


class Extrema(eqx.Module):
    """Maxima and minima over a vector, whose reductions begin at minus and plus infinity."""

    def __call__(self, state, control):
        return jnp.stack([jnp.max(state * control[0]), jnp.min(state), control[1] * jnp.max(state)])


@needs_compiler
@pytest.mark.parametrize(
    ("rate", "method", "columns"),
    [
        pytest.param(RATES["rigid body"], tableaus.CLASSICAL, 3, marks=pytest.mark.slow),
        (RATES["no parameters"], tableaus.SIXTH_ORDER, 4),
        (RATES["every operation"], tableaus.CLASSICAL, 1),
        ((Extrema(), 2, 2), tableaus.CLASSICAL, 2),
    ],
    ids=[*RATES, "extrema"],
)
def test_kernel_equals_jax(rate, method, columns, emulated):
    intervals, w, data = random_case(*rate, method, order=1, outputs=False)
    found = jax.jit(emulated(columns))(intervals, w, data)
    assert_same(jax.jit(in_jax.linearise)(intervals, w, data), found)


@pytest.mark.slow
@needs_compiler
def test_kernel_equals_dispatch_on_a_landing(emulated):
    """With the intervals of ``discretise``."""
    problem = short_problem()
    w = integration_inputs(problem, random_nodes(problem, 1))
    intervals = Intervals(problem.slope, problem.state_size, METHOD, 10, 10)
    arguments = intervals, w, without_data(intervals, w.shape[0])
    assert_same(eqx.filter_jit(dispatch.linearise)(*arguments), eqx.filter_jit(emulated(2))(*arguments))


@needs_compiler
def test_batch_elements_have_their_own_parameters_and_share_no_nan(emulated):
    """Batched twice; NaN in a parameter of one element, and in an interval's variable of another."""
    rate, states, controls = RATES["every operation"]
    intervals, w, data = random_case(rate, states, controls, tableaus.CLASSICAL, order=1, outputs=False)
    scales = jnp.array([[1.0, 0.5, 0.8], [0.1, jnp.nan, 0.9]])
    ws = (w * scales[:, :, None, None]).at[1, 1].set(w).at[0, 2, 7, 1].set(jnp.nan)

    def all_by(linearise):
        def one(scale, w):
            scaled = eqx.tree_at(lambda i: i.rate, intervals, EveryOperation(rate.weight * scale))
            return linearise(scaled, w, data)

        return jax.jit(jax.vmap(jax.vmap(one)))(scales, ws)

    expected, found = all_by(in_jax.linearise), all_by(emulated(2))
    assert not np.isfinite(found[0].end[1, 1]).any()
    assert np.isnan(found[1].end[0, 2, 7]).any()
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        good = np.ones((2, 3, w.shape[0]), bool)
        good[1, 1], good[0, 2, 7] = False, False
        assert_same(a[good], b[good])


class Kinked(eqx.Module):
    def __call__(self, state, control):
        x, y = state
        return jnp.stack([jnp.maximum(x, y), jnp.minimum(x, y), control[0]])


@needs_compiler
def test_nan_in_either_operand_of_a_maximum_or_minimum_gives_nan_in_its_interval_alone(emulated):
    intervals, w, data = random_case(Kinked(), 2, 2, tableaus.CLASSICAL, order=1, outputs=False)
    w = w.at[3, 0].set(jnp.nan).at[5, 1].set(jnp.nan)
    found, _ = jax.jit(emulated(1))(intervals, w, data)
    expected = np.zeros(found.end.shape, bool)
    expected[[3, 5]] = True
    np.testing.assert_array_equal(np.isnan(found.end), expected)


@needs_nvidia
@pytest.mark.parametrize("capability", ["80", "90"])
def test_kernel_compiles(capability):
    intervals, w, _ = random_case(*RATES["every operation"], tableaus.CLASSICAL, order=1, outputs=False)
    cubin = launch.cubin(in_cuda.record(intervals, w.shape[1]).text, capability, "the integration")
    assert cubin is not None
    assert cubin.startswith(b"\x7fELF")


@needs_nvidia
def test_a_kernel_that_does_not_compile_warns():
    with pytest.warns(UserWarning, match="integration's kernel does not compile, and it runs as JAX"):
        assert launch.cubin("no text of a kernel", "90", "the integration") is None


def test_a_gpu_runs_the_kernel_and_other_devices_do_not(monkeypatch):
    """Lowered as on a machine with a GPU."""
    intervals, w, data = random_case(*RATES["every operation"], tableaus.CLASSICAL, order=1, outputs=False)
    assert not in_cuda.supports(intervals, w)
    as_on_a_gpu(monkeypatch)

    def calls(platform, intervals, w, data):
        traced = jax.jit(jax.vmap(lambda w: dispatch.linearise(intervals, w, data))).trace(w[None])
        return native.LIBRARY.on_gpu in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda", intervals, w, data)
    assert not calls("cpu", intervals, w, data)
    assert not in_cuda.supports(intervals, w.astype(jnp.float32))
    with_ends = eqx.tree_at(lambda i: i.path_outputs, intervals, PathOutputs(at_ends=Rows(2).at_ends))
    assert not in_cuda.supports(with_ends, w)
