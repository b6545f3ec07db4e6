"""Gram matrices against their definition with dense weight matrices, in C++ and in JAX."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.linalg.gram import in_jax, native
from jaxscp.linalg.gram.dispatch import gram
from jaxscp.linalg.gram.system import GramSums, WeightedRows

ROUNDING = 1e-13  # relative, of sums of hundreds of products

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the C++ was not compiled: no compiler at installation"
)


def random_parts(seed, shapes, locations, inputs, vectors):
    """Constraints of shapes (points, rows, has a rank-one term)."""
    random = np.random.default_rng(seed)

    def one(points, rows, rank_one):
        draw = lambda *size: jnp.asarray(random.standard_normal((locations, points, rows, *size)))  # noqa: E731
        return WeightedRows(draw(inputs), draw(), draw() if rank_one else None, draw(vectors))

    return tuple(one(*shape) for shape in shapes)


def dense(parts):
    """Sums by the definition, with the whole weight matrix of each point."""
    matrices, products = [], []
    for location in range(parts[0].jacobian.shape[0]):
        matrix, product = 0.0, 0.0
        for part in parts:
            for point in range(part.jacobian.shape[1]):
                j = np.asarray(part.jacobian[location, point])
                weight = np.diag(np.asarray(part.weight[location, point]))
                if part.rank_one is not None:
                    rank_one = np.asarray(part.rank_one[location, point])
                    weight = weight + np.outer(rank_one, rank_one)
                matrix = matrix + j.T @ weight @ j
                product = product + np.asarray(part.vectors[location, point]).T @ j
        matrices.append(matrix)
        products.append(product)
    return GramSums(jnp.stack(matrices), jnp.stack(products))


def assert_same(found, expected):
    for u, v in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert u.shape == v.shape
        size = max(1.0, float(np.max(np.abs(v), initial=0.0)))
        np.testing.assert_allclose(u, v, rtol=0, atol=100 * ROUNDING * size)


@pytest.mark.parametrize(
    "implementation",
    [pytest.param(in_jax.gram, marks=pytest.mark.slow), pytest.param(native.gram, marks=compiled)],
)
@pytest.mark.slow
@given(
    seed=st.integers(0, 1000),
    shapes=st.lists(st.tuples(st.integers(1, 3), st.integers(1, 4), st.booleans()), min_size=1, max_size=3),
    locations=st.integers(1, 4),
    inputs=st.integers(1, 26),  # a register holds eight at most
    vectors=st.integers(0, 3),
)
@settings(max_examples=25, deadline=None)
def test_sums_are_those_of_the_dense_matrices(implementation, seed, shapes, locations, inputs, vectors):
    parts = random_parts(seed, shapes, locations, inputs, vectors)
    assert_same(jax.jit(implementation)(parts), dense(parts))


@compiled
@pytest.mark.parametrize("inputs", [1, 2, 7, 8, 23])
def test_every_instruction_set_gives_the_same(inputs, at_level):
    parts = random_parts(0, [(6, 6, False), (6, 3, True), (1, 8, False)], 3, inputs, 3)
    at_level(native, "TARGET")
    assert_same(native.gram(parts), dense(parts))


@compiled
def test_batches_and_threads_change_no_bit():
    parts = random_parts(0, [(6, 6, False), (6, 3, True), (1, 8, False)], 200, 23, 3)
    whole = jax.jit(gram)(parts)
    assert_same(whole, dense(parts))
    batch = jax.tree.map(lambda v: v.reshape(8, 25, *v.shape[1:]), parts)
    batched = jax.jit(jax.vmap(gram))(batch)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(batched), strict=True):
        np.testing.assert_array_equal(a, b.reshape(a.shape))


@compiled
def test_a_location_with_nan_affects_no_other():
    parts = random_parts(0, [(2, 3, True)], 4, 9, 1)
    damaged = (eqx.tree_at(lambda p: p.jacobian, parts[0], parts[0].jacobian.at[2, 1, 0, 3].set(jnp.nan)),)
    clean, found = gram(parts), gram(damaged)
    others = np.array([0, 1, 3])
    np.testing.assert_array_equal(found.matrix[others], clean.matrix[others])
    assert bool(jnp.isnan(found.matrix[2, 3, 3]))
    assert bool(jnp.isnan(found.products[2, 0, 3]))
