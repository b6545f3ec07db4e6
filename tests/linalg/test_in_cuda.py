"""The CUDA kernels of eigenvalues and Gram matrices without a GPU: on a CPU with emulated threads, and by NVRTC."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.linalg.eigen import dispatch as eigenvalues
from jaxscp.linalg.eigen.native import gpu as eigen_on_gpu
from jaxscp.linalg.gram.dispatch import gram
from jaxscp.linalg.gram.native import gpu as gram_on_gpu
from tests.linalg.test_eigen import assert_nearest, with_eigenvalues
from tests.linalg.test_gram import assert_same, dense, random_parts
from tests.support.kernels import as_on_a_gpu, kernels_here, needs_compiler, needs_nvidia

# (points, rows, has a rank-one term): more and fewer than the four rows of a tile
SHAPES = [(6, 6, False), (5, 3, True), (1, 1, False), (1, 2, True)]


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """Kernels on a CPU in place of those of a GPU."""
    for module in (eigen_on_gpu, gram_on_gpu):
        kernels_here(module, tmp_path, monkeypatch)


def symmetric(seed, *shape):
    matrices = np.random.default_rng(seed).standard_normal(shape)
    return matrices + np.swapaxes(matrices, -1, -2)


@needs_compiler
@pytest.mark.parametrize(
    "size", [23, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2, 3, 8, 31, 32))]
)
def test_eigenvalues_are_those_of_lapack(size, emulated):
    assert_nearest(jnp.asarray(symmetric(3, 3, size, size)), eigen_on_gpu)


@needs_compiler
def test_repeated_tiny_and_huge_eigenvalues(emulated):
    random, size = np.random.default_rng(0), 9
    signs = np.sign(random.standard_normal(size))
    spectra = [signs * 10.0 ** random.uniform(-14, 0, size), signs, np.r_[-1.0, np.zeros(size - 1)]]
    hard = [with_eigenvalues(i, values) for i, values in enumerate([*spectra, 1e150 * signs, 1e-150 * signs])]
    hard += [np.zeros((size, size)), np.eye(size), np.diag(signs)]
    hard.append(np.diag(np.ones(size - 1), 1) + np.diag(np.ones(size - 1), -1))  # tridiagonal, no diagonal
    assert_nearest(jnp.asarray(np.stack(hard)), eigen_on_gpu)


@needs_compiler
@pytest.mark.slow
def test_a_matrix_that_is_not_finite_affects_no_other(emulated):
    matrices = jnp.asarray(symmetric(1, 3, 5, 5))
    damaged = matrices.at[0, 2, 1].set(jnp.nan).at[2, 0, 0].set(jnp.inf)
    for function in (eigen_on_gpu.nearest, eigen_on_gpu.eigen):
        for clean, found in zip(function(matrices), function(damaged), strict=True):
            np.testing.assert_array_equal(found[1], clean[1])
            assert bool(jnp.all(jnp.isnan(found[jnp.array([0, 2])])))


@needs_compiler
@pytest.mark.parametrize(
    ("inputs", "vectors"),
    [(5, 3), pytest.param(23, 3, marks=pytest.mark.slow), pytest.param(8, 0, marks=pytest.mark.slow)],
)
def test_sums_are_those_of_the_dense_matrices(inputs, vectors, emulated):
    """Of a batch; its locations end within a block of threads."""
    parts = random_parts(0, SHAPES, 6, inputs, vectors)
    batch = jax.tree.map(lambda v: v.reshape(2, 3, *v.shape[1:]), parts)
    found = jax.vmap(gram_on_gpu.gram)(batch)
    assert_same(jax.tree.map(lambda v: v.reshape(6, *v.shape[2:]), found), dense(parts))


@needs_nvidia
def test_kernels_compile(monkeypatch):
    monkeypatch.setattr(gram_on_gpu.cuda, "capability", lambda: "90")
    kernels = [
        eigen_on_gpu._kernel(23, nearest=True),
        eigen_on_gpu._kernel(32, nearest=False),
        gram_on_gpu._kernel(random_parts(0, SHAPES, 2, 23, 3)),
        gram_on_gpu._kernel(random_parts(0, SHAPES[:1], 2, 48, 0)),
    ]
    assert all(kernel is not None and kernel.cubin.startswith(b"\x7fELF") for kernel in kernels)


@pytest.mark.parametrize("part", ["eigenvalues", "gram"])
def test_a_gpu_runs_the_kernels_and_other_devices_do_not(part, monkeypatch):
    """Lowered as on a machine with a GPU."""
    module, function, argument = {
        "eigenvalues": (eigen_on_gpu, eigenvalues.nearest, jnp.zeros((3, 4, 4))),
        "gram": (gram_on_gpu, gram, random_parts(0, SHAPES, 2, 5, 3)),
    }[part]
    assert not module.supports(argument)
    as_on_a_gpu(monkeypatch)

    def calls(platform):
        traced = jax.jit(lambda v: function(v)).trace(argument)
        return module.LIBRARY.on_gpu in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda")
    assert not calls("cpu")


def test_sizes_beyond_a_warp_are_left_to_jax(monkeypatch):
    as_on_a_gpu(monkeypatch)
    assert eigen_on_gpu.supports(jnp.zeros((1, 32, 32)))
    assert not eigen_on_gpu.supports(jnp.zeros((1, 33, 33)))
    assert not eigen_on_gpu.supports(jnp.zeros((1, 0, 0)))
    assert gram_on_gpu.supports(random_parts(0, SHAPES, 1, 48, 8))
    assert not gram_on_gpu.supports(random_parts(0, SHAPES, 1, 49, 8))
    assert not gram_on_gpu.supports(random_parts(0, SHAPES, 1, 48, 9))
