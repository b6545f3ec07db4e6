"""Normal matrices: the sums over weighted rows against those of a dense matrix, in C++ and as JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.linalg.gram import in_jax, native
from jaxscp.linalg.gram.dispatch import gram
from jaxscp.linalg.gram.system import GramSums, WeightedRows

ROUNDING = 1e-13  # relative, of sums of some hundred products

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the sums were not compiled: no C++ compiler at installation"
)


def random_parts(seed, shapes, places, inputs, sides):
    """Constraints of so many points and rows, some of whose rows are coupled."""
    random = np.random.default_rng(seed)

    def one(points, rows, coupled):
        draw = lambda *size: jnp.asarray(random.standard_normal((places, points, rows, *size)))  # noqa: E731
        return WeightedRows(draw(inputs), draw(), draw() if coupled else None, draw(sides))

    return tuple(one(*shape) for shape in shapes)


def dense(parts):
    """By the definition: each place's rows under one another, and their whole weight matrix."""
    matrices, sides = [], []
    for place in range(parts[0].jacobian.shape[0]):
        matrix, pulled = 0.0, 0.0
        for part in parts:
            for point in range(part.jacobian.shape[1]):
                j = np.asarray(part.jacobian[place, point])
                weight = np.diag(np.asarray(part.weight[place, point]))
                if part.along is not None:
                    along = np.asarray(part.along[place, point])
                    weight = weight + np.outer(along, along)
                matrix = matrix + j.T @ weight @ j
                pulled = pulled + np.asarray(part.sides[place, point]).T @ j
        matrices.append(matrix)
        sides.append(pulled)
    return GramSums(jnp.stack(matrices), jnp.stack(sides))


def assert_same(found, expected):
    for u, v in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert u.shape == v.shape
        size = max(1.0, float(np.max(np.abs(v), initial=0.0)))
        np.testing.assert_allclose(u, v, rtol=0, atol=100 * ROUNDING * size)


@pytest.mark.parametrize("way", [in_jax.gram, pytest.param(native.gram, marks=compiled)])
@given(
    seed=st.integers(0, 1000),
    shapes=st.lists(st.tuples(st.integers(1, 3), st.integers(1, 4), st.booleans()), min_size=1, max_size=3),
    places=st.integers(1, 4),
    inputs=st.integers(1, 26),  # a register holds eight at most
    sides=st.integers(0, 3),
)
@settings(max_examples=25, deadline=None)
def test_sums_are_those_of_the_dense_matrices(way, seed, shapes, places, inputs, sides):
    parts = random_parts(seed, shapes, places, inputs, sides)
    assert_same(way(parts), dense(parts))


@compiled
@pytest.mark.parametrize("inputs", [1, 2, 7, 8, 23])
def test_every_level_that_runs_here_gives_the_same(inputs, at_level):
    parts = random_parts(0, [(6, 6, False), (6, 3, True), (1, 8, False)], 3, inputs, 3)
    at_level(native, "TARGET")
    assert_same(native.gram(parts), dense(parts))


@compiled
def test_many_places_and_lanes_are_shared_among_threads_without_a_change():
    parts = random_parts(0, [(6, 6, False), (6, 3, True), (1, 8, False)], 200, 23, 3)
    whole = jax.jit(gram)(parts)
    assert_same(whole, dense(parts))
    in_lanes = jax.tree.map(lambda v: v.reshape(8, 25, *v.shape[1:]), parts)
    lanes = jax.jit(jax.vmap(gram))(in_lanes)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(lanes), strict=True):
        np.testing.assert_array_equal(a, b.reshape(a.shape))


@compiled
def test_a_place_that_is_no_number_spoils_no_other():
    parts = random_parts(0, [(2, 3, True)], 4, 9, 1)
    spoilt = (
        WeightedRows(
            parts[0].jacobian.at[2, 1, 0, 3].set(jnp.nan), parts[0].weight, parts[0].along, parts[0].sides
        ),
    )
    clean, found = gram(parts), gram(spoilt)
    others = np.array([0, 1, 3])
    np.testing.assert_array_equal(found.matrix[others], clean.matrix[others])
    assert bool(jnp.isnan(found.matrix[2, 3, 3]))
    assert bool(jnp.isnan(found.sides[2, 0, 3]))
