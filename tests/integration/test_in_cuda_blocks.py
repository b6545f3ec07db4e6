"""The CUDA kernels with path outputs, without a GPU: compiled for a CPU with emulated threads, and by NVRTC."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import cuda, launch
from jaxscp.backends.serving import PerformanceWarning
from jaxscp.integration import (
    dispatch,
    in_cuda_blocks,
    in_jax,
    interval_tapes,
    native,
    tableaus,
)
from jaxscp.integration.intervals import PathOutputs
from jaxscp.integration.native import interval_source
from jaxscp.transcription import shooting
from tests.support.flights import random_nodes, short_problem
from tests.support.interval_problems import ORDERS, RATES, EveryOperation, assert_same, random_case
from tests.support.kernels import as_on_a_gpu, compiled, handler, needs_compiler, needs_nvidia

FOLDER = Path(native.__file__).parent


def emulated(folder, order):
    """The integration up to an order by the kernel, as a function of the arguments of ``dispatch``'s functions."""

    def integrate(intervals, w, data, multipliers=None):
        inputs = w.shape[-1]
        tapes = interval_tapes.record(intervals, inputs, data, order)
        source = interval_source.Source(intervals, tapes, inputs, order)
        threads, group = interval_source.threads(inputs), interval_source.PATH_THREADS
        here = {name: folder / name for name in ("paths", "columns")}
        for path in here.values():
            path.mkdir(exist_ok=True)
        code = compiled(source.paths, here["paths"], "warps_on_a_cpu.h", [FOLDER])
        paths, columns = launch.Kernel(handler(), code, 1, group, shared=source.shared_by_paths), None
        if order:
            code = compiled(source.columns, here["columns"], "warps_on_a_cpu.h", [FOLDER])
            columns = launch.Kernel(handler(), code, threads, threads, shared=source.shared)
        kernels = in_cuda_blocks.Kernels(paths, source.stored, source.stored_of_slopes, columns)
        found = in_cuda_blocks.integrate(intervals, tapes, kernels, w, data, multipliers, order)
        return found if order else found[0]

    return integrate


@needs_compiler
@pytest.mark.parametrize(
    "function", [pytest.param(f, marks=[pytest.mark.slow] * (f == "evaluate")) for f in ORDERS]
)
@pytest.mark.parametrize("rate", ["no parameters", pytest.param("every operation", marks=pytest.mark.slow)])
def test_kernel_equals_jax(rate, function, tmp_path):
    order = ORDERS[function]
    case = random_case(*RATES[rate], tableaus.SIXTH_ORDER, order)
    expected = jax.jit(getattr(in_jax, function))(*case)
    assert_same(expected, jax.jit(emulated(tmp_path, order))(*case))


def at_the_ends_alone(intervals, w, data, *multipliers):
    """The case without rows at the points."""
    rows = PathOutputs(at_ends=intervals.path_outputs.at_ends)
    data = eqx.tree_at(lambda d: d.point, data, jnp.zeros((len(w), 0)))
    alone = eqx.tree_at(
        lambda i: i.path_outputs, intervals, rows, is_leaf=lambda v: isinstance(v, PathOutputs)
    )
    return (alone, w, data, *(eqx.tree_at(lambda m: m.points, m, ()) for m in multipliers))


@needs_compiler
def test_kernel_equals_jax_without_rows_at_the_points(tmp_path):
    case = at_the_ends_alone(*random_case(*RATES["no parameters"], tableaus.CLASSICAL))
    assert_same(jax.jit(in_jax.linearise_with_hessian)(*case), jax.jit(emulated(tmp_path, 2))(*case))


@pytest.mark.nightly
@needs_compiler
def test_kernel_equals_dispatch_on_a_landing(tmp_path):
    problem = short_problem(everything=True)
    grid = shooting.Grid()
    intervals = shooting.intervals_of(problem, grid)
    w = shooting.integration_inputs(problem, random_nodes(problem, 1))
    data = shooting.interval_data(problem, grid)
    like = jax.eval_shape(in_jax.evaluate, intervals, w, data)
    random = np.random.default_rng(1)
    multipliers = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), like)
    case = intervals, w, data, multipliers
    expected = eqx.filter_jit(dispatch.linearise_with_hessian)(*case)
    found = eqx.filter_jit(emulated(tmp_path, 2))(*case)
    assert_same(expected, found)
    np.testing.assert_array_equal(found[2], jnp.swapaxes(found[2], 1, 2))


@pytest.mark.nightly
@needs_compiler
def test_more_columns_than_a_warp_has(tmp_path):
    class Chain(eqx.Module):
        def __call__(self, state, control):
            slope = jnp.sin(jnp.roll(state, 1)) * control[0] + state * control[1]
            return jnp.append(slope, jnp.sum(control**2))

    case = random_case(Chain(), 30, 2, tableaus.CLASSICAL)
    expected = jax.jit(in_jax.linearise_with_hessian)(*case)
    assert_same(expected, jax.jit(emulated(tmp_path, 2))(*case))


@pytest.mark.slow
@needs_compiler
def test_batch_elements_have_their_own_parameters_and_share_no_nan(tmp_path):
    """NaN in a parameter of one element, and in an interval's variable of another."""
    rate, states, controls = RATES["every operation"]
    intervals, w, data, multipliers = random_case(rate, states, controls, tableaus.CLASSICAL)
    scales = jnp.array([0.5, jnp.nan, 0.8])
    ws = jnp.stack([w, w, w.at[7, 1].set(jnp.nan)])

    def all_by(integrate):
        def one(scale, w):
            scaled = eqx.tree_at(lambda i: i.rate, intervals, EveryOperation(rate.weight * scale))
            return integrate(scaled, w, data, multipliers)

        return jax.jit(jax.vmap(one))(scales, ws)

    expected, found = all_by(in_jax.linearise_with_hessian), all_by(emulated(tmp_path, 2))
    assert not np.isfinite(found[0].end[1]).any()
    assert np.isnan(found[2][2, 7]).any()
    good = np.ones(ws.shape[:2], bool)
    good[1], good[2, 7] = False, False
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        assert_same(a[good], b[good])


@needs_nvidia
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("part", [lambda *case: case, at_the_ends_alone], ids=["all rows", "ends alone"])
def test_kernel_compiles(part, order):
    intervals, w, data = part(*random_case(*RATES["every operation"], tableaus.CLASSICAL, order=1))
    tapes = interval_tapes.record(intervals, w.shape[1], data, order)
    kernels = in_cuda_blocks.kernels(intervals, tapes, w.shape[1], order, "90")
    assert kernels is not None
    assert kernels.paths.cubin.startswith(b"\x7fELF")
    assert (kernels.columns is None) == (order == 0)


def test_an_interval_too_large_for_shared_memory_has_no_kernel(monkeypatch):
    intervals, w, data = random_case(*RATES["no parameters"], tableaus.CLASSICAL, order=1)
    tapes = interval_tapes.record(intervals, w.shape[1], data, 1)
    monkeypatch.setattr(cuda, "shared_memory", lambda _: 100)
    with pytest.warns(PerformanceWarning, match="bytes of a GPU's shared memory, of which a block has 100"):
        assert in_cuda_blocks.kernels(intervals, tapes, w.shape[1], 1, "90") is None


@pytest.mark.slow
def test_a_gpu_runs_the_kernel_and_other_devices_do_not(monkeypatch):
    """Lowered as on a machine with a GPU."""
    case = random_case(*RATES["every operation"], tableaus.CLASSICAL)
    as_on_a_gpu(monkeypatch)

    def calls(platform):
        traced = jax.jit(jax.vmap(dispatch.linearise_with_hessian, (None, 0, None, None))).trace(
            case[0], case[1][None], *case[2:]
        )
        return native.LIBRARY.on_gpu in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda")
    assert not calls("cpu")
