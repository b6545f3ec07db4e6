"""The nearest semidefinite matrices: against LAPACK's eigenvalues, on matrices that are hard to take apart."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.linalg.eigen import in_jax, native
from jaxscp.linalg.eigen.dispatch import eigen, nearest
from jaxscp.linalg.eigen.pseudo_inverse import pseudo_inverse

ROUNDING = 1e-13  # of the largest entry: some hundred rotations, each to 1e-16
STEP, DIFFERENCES = (
    1e-6,
    1e-6,
)  # of central differences: rounding by the step, and a thousand times the step's square
CUT = (
    1e-9  # of the largest singular value: the others of matrices without full rank are zero but for rounding
)

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the projection was not compiled: no C++ compiler at installation"
)


def with_eigenvalues(seed, values):
    """A symmetric matrix of these eigenvalues, in directions drawn at random."""
    vectors, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(values), len(values))))
    return vectors * values @ vectors.T


def assert_nearest(matrices):
    found, least = nearest(matrices)
    values, vectors = np.linalg.eigh(matrices)
    expected = vectors * np.maximum(values, 0.0)[:, None, :] @ np.swapaxes(vectors, 1, 2)
    size = np.maximum(np.max(np.abs(matrices), axis=(1, 2)), 1e-300)
    np.testing.assert_allclose(found / size[:, None, None], expected / size[:, None, None], atol=ROUNDING)
    np.testing.assert_allclose(least / size, values[:, 0] / size, atol=ROUNDING)
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))
    ours, columns = map(np.asarray, eigen(matrices))
    np.testing.assert_allclose(np.sort(ours) / size[:, None], values / size[:, None], atol=ROUNDING)
    eye = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    np.testing.assert_allclose(np.swapaxes(columns, 1, 2) @ columns, eye, atol=ROUNDING)
    again = columns * (ours / size[:, None])[:, None, :] @ np.swapaxes(columns, 1, 2)
    np.testing.assert_allclose(again, matrices / size[:, None, None], atol=ROUNDING)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 19), size=st.integers(1, 26))
@settings(max_examples=25, deadline=None)
def test_random_matrices(seed, count, size):
    matrices = np.random.default_rng(seed).standard_normal((count, size, size))
    assert_nearest(jnp.asarray(matrices + np.swapaxes(matrices, 1, 2)))


def test_matrices_that_are_hard_to_take_apart():
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
def test_every_level_that_runs_here_gives_the_same(size, at_level):
    matrices = np.random.default_rng(3).standard_normal((11, size, size))
    at_level(native, "NEAREST", "EIGEN")
    assert_nearest(jnp.asarray(matrices + np.swapaxes(matrices, 1, 2)))


@compiled
def test_what_is_no_number_spoils_nothing_else():
    matrices = np.random.default_rng(1).standard_normal((11, 7, 7))
    matrices = jnp.asarray(matrices + np.swapaxes(matrices, 1, 2))
    spoilt = matrices.at[3, 2, 1].set(jnp.nan).at[9, 0, 0].set(jnp.inf)
    (clean, least), (found, lowest) = nearest(matrices), nearest(spoilt)
    others = np.array([i for i in range(11) if i not in (3, 9)])
    np.testing.assert_array_equal(found[others], clean[others])
    np.testing.assert_array_equal(lowest[others], least[others])
    assert bool(jnp.all(jnp.isnan(found[np.array([3, 9])])))
    assert bool(jnp.all(jnp.isnan(lowest[np.array([3, 9])])))


@compiled
def test_lanes_of_a_batch_and_the_same_as_jax():
    matrices = np.random.default_rng(2).standard_normal((4, 29, 9, 9))
    matrices = jnp.asarray(matrices + np.swapaxes(matrices, 2, 3))
    found, least = jax.jit(jax.vmap(nearest))(matrices)
    expected, lowest = jax.jit(jax.vmap(in_jax.nearest))(matrices)
    np.testing.assert_allclose(found, expected, atol=1e2 * ROUNDING)
    np.testing.assert_allclose(least, lowest, atol=1e2 * ROUNDING)


@pytest.mark.parametrize(
    ("rows", "columns", "rank"), [(6, 4, 4), (6, 4, 3), (6, 8, 6), (6, 8, 4), (1, 1, 1), (1, 1, 0)]
)
def test_pseudo_inverse_and_its_derivative_where_the_rank_stays(rows, columns, rank):
    random = np.random.default_rng(rows + columns + rank)
    left, along_left = random.standard_normal((2, rows, rank))
    right, along_right = random.standard_normal((2, rank, columns)) * 10.0 ** random.uniform(-1, 1, columns)
    matrix = lambda t: (left + t * along_left) @ (right + t * along_right)  # noqa: E731
    slope = along_left @ right + left @ along_right
    inverse, found = jax.jvp(pseudo_inverse, (jnp.asarray(matrix(0.0)),), (jnp.asarray(slope),))
    ahead, here, behind = (np.linalg.pinv(matrix(t), rcond=CUT) for t in (STEP, 0.0, -STEP))
    size = max(1.0, np.abs(here).max()) ** 2
    np.testing.assert_allclose(inverse / size, here / size, atol=ROUNDING)
    np.testing.assert_allclose(found / size, (ahead - behind) / (2 * STEP) / size, atol=DIFFERENCES)
