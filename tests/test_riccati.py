"""The Newton system of a chain: the recursion against a dense solve, convex blocks or not."""

import dataclasses

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import riccati

ROUNDING = 1e-8  # relative; after refinement, of systems whose condition is about 1e6


def random_chain(seed, convex):
    """A chain of 5 intervals with 4 states and 2 controls; its cost is convex in the directions the dynamics leave."""
    random = np.random.default_rng(seed)
    intervals, states, controls = 5, 4, 2
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
    ends = random.standard_normal((2, 3, states))
    return riccati.Chain(*map(jnp.asarray, (hessian, last, flow, ends[0], ends[1])))


def random_side(chain, seed):
    random = np.random.default_rng(seed)
    nodes, stage = chain.flow.shape[0] + 1, chain.last.shape[0]
    shapes = ((nodes, stage), chain.flow.shape[:2], chain.initial.shape[:1], chain.final.shape[:1])
    return riccati.Side(*(jnp.asarray(random.standard_normal(s)) for s in shapes))


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
