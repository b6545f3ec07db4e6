"""Block tridiagonal factorisation against a dense solve."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.linalg import block_tridiagonal


@pytest.mark.parametrize(("blocks", "size"), [(1, 3), (2, 1), (7, 4)])
def test_block_tridiagonal_solves_the_dense_system(blocks, size):
    random = np.random.default_rng(blocks)
    above = random.standard_normal((blocks, size, size))
    above[-1] = 0.0
    root = random.standard_normal((blocks, size, size))
    diagonal = root @ np.swapaxes(root, 1, 2) + 6.0 * size * np.eye(size)
    dense = np.zeros((blocks * size, blocks * size))
    for i in range(blocks):
        at, beside = slice(i * size, (i + 1) * size), slice((i + 1) * size, (i + 2) * size)
        dense[at, at] = diagonal[i]
        if i + 1 < blocks:
            dense[at, beside], dense[beside, at] = above[i], above[i].T
    right = random.standard_normal((blocks, size))
    factor = jax.jit(block_tridiagonal.factor)(jnp.asarray(diagonal), jnp.asarray(above))
    found = jax.jit(block_tridiagonal.solve)(factor, jnp.asarray(right))
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(dense, right.ravel()), atol=1e-11)
