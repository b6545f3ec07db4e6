"""The CUDA kernels of the Riccati recursion without a GPU: compiled for a CPU with emulated threads, and by NVRTC."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import launch
from jaxscp.linalg import riccati
from jaxscp.linalg.riccati import in_jax, recursion
from jaxscp.linalg.riccati.native import gpu
from tests.linalg.test_riccati import random_lq, random_vector
from tests.support.kernels import as_on_a_gpu, kernels_here, needs_compiler, needs_nvidia

SHIFTS = riccati.Shifts(growth=8.0, most=1e4)
ROUNDING, UNREFINED = 1e-9, 1e-7  # relative; without refinement, penalties raise the condition number


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """Kernels on a CPU in place of those of a GPU."""
    kernels_here(gpu, tmp_path, monkeypatch)


def assert_close(expected, found, tolerance=ROUNDING):
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        np.testing.assert_allclose(b, a, rtol=0, atol=tolerance * np.max(np.abs(a), initial=1.0))


@needs_compiler
@pytest.mark.parametrize("convex", [pytest.param(True, marks=pytest.mark.slow), False])
@pytest.mark.parametrize(
    "sizes", [(5, 4, 2), *(pytest.param(s, marks=pytest.mark.slow) for s in [(3, 2, 1), (2, 5, 2)])]
)
def test_kernels_equal_jax(convex, sizes, emulated):
    """A batch of two, factored and solved; the last solution has no refinement."""
    problems = [random_lq(seed, convex, *sizes) for seed in (0, 1)]
    batch = jax.tree.map(lambda *v: jnp.stack(v), *problems)
    right = jax.tree.map(lambda *v: jnp.stack(v), *(random_vector(p, 2) for p in problems))
    factored = jax.jit(jax.vmap(in_jax.factor))(batch)
    assert_close(factored, jax.jit(jax.vmap(gpu.factor))(batch))
    for refinements, tolerance in ((2, ROUNDING), (0, UNREFINED)):
        by = lambda solve: jax.jit(jax.vmap(functools.partial(solve, refinements=refinements)))  # noqa: E731, B023
        assert_close(by(in_jax.solve)(factored, right), by(gpu.solve)(factored, right), tolerance)


@needs_compiler
def test_a_saddle_is_not_definite_and_its_neighbour_is(emulated):
    problem = random_lq(0, True)
    shift = jnp.array([-1e3, 0.0])
    batch = jax.vmap(problem.shifted)(shift)
    found = jax.vmap(gpu.factor)(batch)
    assert np.array_equal(jax.vmap(lambda f: f.definite)(found), [False, True])


@needs_compiler
def test_each_problem_has_the_first_shift_that_suffices(emulated):
    """A problem that needs none, one that needs several, and one of NaN, which no shift helps."""
    problem = random_lq(0, True, states=3)
    batch = jax.vmap(problem.shifted)(jnp.array([0.0, -30.0, jnp.nan]))
    least = jnp.array([1e-4, 0.5, 1e-4])
    by = lambda function: jax.vmap(functools.partial(function, shifts=SHIFTS))(batch, least)  # noqa: E731
    (expected, shifts), (found, same) = by(recursion.factor_shifted), by(gpu.factor_shifted)
    np.testing.assert_array_equal(shifts, same)
    assert shifts[0] == 0.0
    assert 1.0 < shifts[1] < SHIFTS.most
    assert shifts[2] >= SHIFTS.most
    assert np.array_equal(jax.vmap(lambda f: f.definite)(found), [True, True, False])
    assert all(np.isnan(v[2]).all() for v in (found.value, found.lower, found.gain, found.first))
    first_two = lambda tree: jax.tree.map(lambda v: v[:2], tree)  # noqa: E731
    assert_close(first_two(expected), first_two(found))


@needs_nvidia
def test_kernels_compile():
    sizes = gpu.Sizes(random_lq(0, True))
    for kernel in (gpu.factor_kernel(sizes, "90", SHIFTS), gpu.solve_kernel(sizes, "90", 3)):
        assert kernel is not None
        assert kernel.cubin.startswith(b"\x7fELF")


def test_a_gpu_runs_the_kernels_and_other_devices_do_not(monkeypatch):
    """Lowered as on a machine with a GPU."""
    problem = random_lq(0, True)
    assert not gpu.supports(problem)
    as_on_a_gpu(monkeypatch)

    def calls(platform):
        traced = jax.jit(lambda problem: riccati.factor(problem)).trace(problem)
        return gpu.LIBRARY.on_gpu in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda")
    assert not calls("cpu")


def test_problems_too_large_for_shared_memory_are_left_to_jax(monkeypatch):
    as_on_a_gpu(monkeypatch)
    assert gpu.supports(random_lq(0, True))
    assert not gpu.supports(random_lq(0, True, states=50))
    assert not gpu.supports(random_lq(0, True, intervals=3000))


def test_numbers_of_another_type_are_refused():
    kernel = launch.Kernel("no target", b"a cubin", 1, 1)
    with pytest.raises(TypeError, match="a kernel takes float64, got float64, float32"):
        kernel(jnp.zeros(2), jnp.zeros(2, jnp.float32), shapes=[(2,)])
