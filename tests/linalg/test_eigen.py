"""Eigenvalues and nearest semidefinite matrices, against LAPACK."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.linalg.eigen import dispatch, in_jax, native
from jaxscp.linalg.eigen.dispatch import nearest
from jaxscp.linalg.eigen.pseudo_inverse import pseudo_inverse

ROUNDING = 1e-13  # relative to the largest entry: hundreds of rotations, each to 1e-16
STEP = 1e-6  # of central differences
DIFFERENCES = 1e-6  # error of central differences: rounding over STEP, and a thousand times STEP squared
CUTOFF = 1e-9  # relative to the largest singular value: smaller ones are rounding of zero

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the C++ was not compiled: no compiler at installation"
)


def with_eigenvalues(seed, values):
    """Symmetric matrix with these eigenvalues and random eigenvectors."""
    vectors, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(values), len(values))))
    return vectors * values @ vectors.T


def assert_nearest(matrices, by=dispatch):
    """``by``: the module whose functions find them."""
    found, least = by.nearest(matrices)
    values, vectors = np.linalg.eigh(matrices)
    expected = vectors * np.maximum(values, 0.0)[:, None, :] @ np.swapaxes(vectors, 1, 2)
    size = np.maximum(np.max(np.abs(matrices), axis=(1, 2)), 1e-300)
    np.testing.assert_allclose(found / size[:, None, None], expected / size[:, None, None], atol=ROUNDING)
    np.testing.assert_allclose(least / size, values[:, 0] / size, atol=ROUNDING)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))
    ours, columns = map(np.asarray, by.eigen(matrices))
    np.testing.assert_allclose(np.sort(ours) / size[:, None], values / size[:, None], atol=ROUNDING)
    eye = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    np.testing.assert_allclose(np.swapaxes(columns, 1, 2) @ columns, eye, atol=ROUNDING)
    rebuilt = columns * (ours / size[:, None])[:, None, :] @ np.swapaxes(columns, 1, 2)
    np.testing.assert_allclose(rebuilt, matrices / size[:, None, None], atol=ROUNDING)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 19), size=st.integers(1, 26))
@settings(max_examples=25, deadline=None)
def test_random_matrices(seed, count, size):
    matrices = np.random.default_rng(seed).standard_normal((count, size, size))
    assert_nearest(jnp.asarray(matrices + np.swapaxes(matrices, 1, 2)))


def test_repeated_tiny_and_huge_eigenvalues():
    random, size = np.random.default_rng(0), 23
    signs = np.sign(random.standard_normal(size))
    spectra = [
        signs * 10.0 ** random.uniform(-14, 0, size),
        signs,  # two eigenvalues, many times each
        np.r_[1.0, np.zeros(size - 1)],
        np.r_[-1.0, np.zeros(size - 1)],
        1e150 * signs,
        1e-150 * signs,
    ]
    hard = [with_eigenvalues(i, values) for i, values in enumerate(spectra)]
    hard += [np.zeros((size, size)), np.eye(size), -np.eye(size), np.ones((size, size)), np.diag(signs)]
    hard.append(np.diag(np.ones(size - 1), 1) + np.diag(np.ones(size - 1), -1))  # tridiagonal, no diagonal
    assert_nearest(jnp.asarray(np.stack(hard)))


@compiled
@pytest.mark.parametrize("size", [1, 2, 9, 23])
def test_every_instruction_set_gives_the_same(size, at_level):
    matrices = np.random.default_rng(3).standard_normal((11, size, size))
    at_level(native, "NEAREST", "EIGEN")
    assert_nearest(jnp.asarray(matrices + np.swapaxes(matrices, 1, 2)))


@compiled
def test_a_matrix_that_is_not_finite_affects_no_other():
    matrices = np.random.default_rng(1).standard_normal((11, 7, 7))
    matrices = jnp.asarray(matrices + np.swapaxes(matrices, 1, 2))
    damaged = matrices.at[3, 2, 1].set(jnp.nan).at[9, 0, 0].set(jnp.inf)
    (clean, least), (found, lowest) = nearest(matrices), nearest(damaged)
    others = np.array([i for i in range(11) if i not in (3, 9)])
    np.testing.assert_array_equal(found[others], clean[others])
    np.testing.assert_array_equal(lowest[others], least[others])
    assert bool(jnp.all(jnp.isnan(found[np.array([3, 9])])))
    assert bool(jnp.all(jnp.isnan(lowest[np.array([3, 9])])))


@compiled
def test_batches_equal_jax():
    matrices = np.random.default_rng(2).standard_normal((4, 29, 9, 9))
    matrices = jnp.asarray(matrices + np.swapaxes(matrices, 2, 3))
    found, least = jax.jit(jax.vmap(nearest))(matrices)
    expected, lowest = jax.jit(jax.vmap(in_jax.nearest))(matrices)
    np.testing.assert_allclose(found, expected, atol=1e2 * ROUNDING)
    np.testing.assert_allclose(least, lowest, atol=1e2 * ROUNDING)


@pytest.mark.parametrize(
    ("rows", "columns", "rank"), [(6, 4, 4), (6, 4, 3), (6, 8, 6), (6, 8, 4), (1, 1, 1), (1, 1, 0)]
)
def test_pseudo_inverse_and_its_derivative_at_constant_rank(rows, columns, rank):
    random = np.random.default_rng(rows + columns + rank)
    left, left_slope = random.standard_normal((2, rows, rank))
    right, right_slope = random.standard_normal((2, rank, columns)) * 10.0 ** random.uniform(-1, 1, columns)
    matrix = lambda t: (left + t * left_slope) @ (right + t * right_slope)  # noqa: E731
    slope = left_slope @ right + left @ right_slope
    inverse, found = jax.jvp(pseudo_inverse, (jnp.asarray(matrix(0.0)),), (jnp.asarray(slope),))
    after, here, before = (np.linalg.pinv(matrix(t), rcond=CUTOFF) for t in (STEP, 0.0, -STEP))
    size = max(1.0, np.abs(here).max()) ** 2
    np.testing.assert_allclose(inverse / size, here / size, atol=ROUNDING)
    np.testing.assert_allclose(found / size, (after - before) / (2 * STEP) / size, atol=DIFFERENCES)
