"""The Newton system of a chain: the recursion against a dense solve, convex blocks or not, in C++ and as JAX."""

import dataclasses

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.linalg import riccati
from jaxscp.linalg.riccati import in_jax, native

ROUNDING = 1e-8  # relative; after refinement, of systems whose condition is about 1e6
SAME_STEPS = (
    1e-7  # relative; of one solve without refinement, whose penalties make the condition 1e7 and more
)

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the recursion was not compiled: no C++ compiler at installation"
)


def random_chain(seed, convex, intervals=5, states=4, controls=2):
    """A chain whose cost is convex in the directions the dynamics leave."""
    random = np.random.default_rng(seed)
    stage, inputs = states + controls, states + 2 * controls
    square = random.standard_normal((intervals, inputs, inputs))
    hessian = square @ np.swapaxes(square, 1, 2) + np.eye(inputs)
    if not convex:
        # Add x' P x at every node and take it away before the next: no block stays convex, the sum is the same.
        flow = random.standard_normal((intervals, states, inputs)) * 0.5
        shift = 30.0 * np.eye(states)
        hessian = hessian - np.swapaxes(flow, 1, 2) @ shift @ flow
        hessian[1:, :states, :states] += shift
    else:
        flow = random.standard_normal((intervals, states, inputs)) * 0.5
    last = np.eye(stage)
    if not convex:
        last[:states, :states] += 30.0 * np.eye(states)
    ends = random.standard_normal((2, min(3, states), states))
    return riccati.LQProblem(*map(jnp.asarray, (hessian, last, flow, ends[0], ends[1])))


def random_side(chain, seed):
    random = np.random.default_rng(seed)
    nodes, stage = chain.flow.shape[0] + 1, chain.last.shape[0]
    shapes = ((nodes, stage), chain.flow.shape[:2], chain.initial.shape[:1], chain.final.shape[:1])
    return riccati.KKTVector(*(jnp.asarray(random.standard_normal(s)) for s in shapes))


@pytest.mark.parametrize("convex", [True, False])
def test_solves_the_dense_system(convex):
    chain = random_chain(0, convex)
    right = random_side(chain, 1)
    flat, unravel = jax.flatten_util.ravel_pytree(right)
    dense = jax.jacfwd(lambda v: jax.flatten_util.ravel_pytree(riccati.apply(chain, unravel(v)))[0])(flat)
    np.testing.assert_allclose(dense, dense.T, atol=1e-12)
    factor = riccati.factor(chain)
    assert bool(factor.definite)
    if not convex:
        assert float(jnp.min(jnp.linalg.eigvalsh(chain.hessian))) < -1.0
    found = jax.flatten_util.ravel_pytree(riccati.solve(factor, right))[0]
    expected = np.linalg.solve(dense, flat)
    np.testing.assert_allclose(found, expected, atol=ROUNDING * np.max(np.abs(expected)))


def test_a_saddle_is_noticed():
    chain = random_chain(0, True)
    saddle = dataclasses.replace(chain, hessian=chain.hessian.at[2, -1, -1].add(-1e3))
    assert not bool(riccati.factor(saddle).definite)
    assert bool(riccati.factor(saddle.shifted(jnp.asarray(2e3))).definite)


def assert_same(a, b, tolerance):
    for u, v in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert u.shape == v.shape
        size = max(1.0, float(jnp.max(jnp.abs(u), initial=0.0)))
        np.testing.assert_allclose(v, u, rtol=0, atol=tolerance * size)


SHAPES = {
    "one interval": {"intervals": 1, "states": 2, "controls": 1},
    "a register's width": {"intervals": 3, "states": 6, "controls": 2},
    "one more": {"intervals": 9, "states": 7, "controls": 2},
    "a vehicle's": {"intervals": 12, "states": 13, "controls": 5},
    "four registers": {"intervals": 2, "states": 20, "controls": 6},
}


@compiled
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_compiled_steps_are_those_in_jax(shape):
    chain = random_chain(3, True, **shape)
    right = random_side(chain, 4)
    factor = in_jax.factor(chain)
    assert_same(factor, jax.jit(native.factor)(chain), ROUNDING)
    for refinements, tolerance in ((0, SAME_STEPS), (2, ROUNDING)):
        solved = jax.jit(native.solve, static_argnums=2)(factor, right, refinements)
        assert_same(in_jax.solve(factor, right, refinements), solved, tolerance)


@compiled
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_every_level_that_runs_here_gives_the_same(shape, at_level):
    chain = random_chain(3, True, **shape)
    right = random_side(chain, 4)
    factor = in_jax.factor(chain)
    at_level(native, "FACTOR", "SOLVE")
    assert_same(factor, native.factor(chain), ROUNDING)
    assert_same(in_jax.solve(factor, right, 2), native.solve(factor, right, 2), ROUNDING)


@compiled
def test_lanes_of_a_batch_are_those_alone():
    chains = [random_chain(seed, seed % 2 == 0) for seed in range(5)]
    saddle = dataclasses.replace(chains[1], hessian=chains[1].hessian.at[2, -1, -1].add(-1e3))
    chains[1] = saddle
    sides = [random_side(chain, 9) for chain in chains]
    stack = lambda trees: jax.tree.map(lambda *v: jnp.stack(v), *trees)  # noqa: E731

    def both(chain, side):
        factor = riccati.factor(chain)
        return factor, riccati.solve(factor, side)

    factors, found = jax.jit(jax.vmap(both))(stack(chains), stack(sides))
    np.testing.assert_array_equal(jax.vmap(lambda f: f.definite)(factors), [i != 1 for i in range(5)])
    for lane in (0, 2, 3, 4):
        alone = jax.jit(both)(chains[lane], sides[lane])
        jax.tree.map(
            lambda a, b, lane=lane: np.testing.assert_array_equal(a, b[lane]), alone, (factors, found)
        )
