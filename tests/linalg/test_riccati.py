"""The Riccati recursion against a dense solve, with and without convex blocks, in C++ and in JAX."""

import dataclasses

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.linalg import riccati
from jaxscp.linalg.riccati import in_jax, native

ROUNDING = 1e-8  # relative, after refinement; the condition number is about 1e6
UNREFINED = 1e-7  # relative, without refinement; penalties raise the condition number to 1e7 and more

compiled = pytest.mark.skipif(
    not native.LIBRARY.available(), reason="the C++ was not compiled: no compiler at installation"
)


def random_lq(seed, convex, intervals=5, states=4, controls=2):
    """Problem whose cost is convex in the directions that the dynamics leave free."""
    random = np.random.default_rng(seed)
    stage, inputs = states + controls, states + 2 * controls
    square = random.standard_normal((intervals, inputs, inputs))
    hessian = square @ np.swapaxes(square, 1, 2) + np.eye(inputs)
    if not convex:
        # add x' P x at every node and subtract it at the next: no block stays convex, and the sum does not change
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


def random_vector(problem, seed):
    random = np.random.default_rng(seed)
    nodes, stage = problem.flow.shape[0] + 1, problem.last.shape[0]
    shapes = ((nodes, stage), problem.flow.shape[:2], problem.initial.shape[:1], problem.final.shape[:1])
    return riccati.KKTVector(*(jnp.asarray(random.standard_normal(s)) for s in shapes))


# Compiled once for each shape.
factor, solve = jax.jit(riccati.factor), jax.jit(riccati.solve)
factor_in_jax, solve_in_jax = jax.jit(in_jax.factor), jax.jit(in_jax.solve, static_argnums=2)


@jax.jit
def dense_matrix(problem, like):
    """Matrix of the system, column by column; ``like`` is any right-hand side."""
    flat, unravel = jax.flatten_util.ravel_pytree(like)
    return jax.jacfwd(lambda v: jax.flatten_util.ravel_pytree(riccati.apply(problem, unravel(v)))[0])(flat)


@pytest.mark.parametrize("convex", [True, False])
def test_solves_the_dense_system(convex):
    problem = random_lq(0, convex)
    right = random_vector(problem, 1)
    flat, _ = jax.flatten_util.ravel_pytree(right)
    dense = dense_matrix(problem, right)
    np.testing.assert_allclose(dense, dense.T, atol=1e-12)
    factored = factor(problem)
    assert bool(factored.definite)
    if not convex:
        assert float(jnp.min(jnp.linalg.eigvalsh(problem.hessian))) < -1.0
    found = jax.flatten_util.ravel_pytree(solve(factored, right))[0]
    expected = np.linalg.solve(dense, flat)
    np.testing.assert_allclose(found, expected, atol=ROUNDING * np.max(np.abs(expected)))


def test_a_saddle_is_not_definite():
    problem = random_lq(0, True)
    saddle = dataclasses.replace(problem, hessian=problem.hessian.at[2, -1, -1].add(-1e3))
    assert not bool(factor(saddle).definite)
    assert bool(factor(saddle.shifted(jnp.asarray(2e3))).definite)


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
def test_compiled_equals_jax(shape):
    problem = random_lq(3, True, **shape)
    right = random_vector(problem, 4)
    expected = factor_in_jax(problem)
    assert_same(expected, jax.jit(native.factor)(problem), ROUNDING)
    for refinements, tolerance in ((0, UNREFINED), (2, ROUNDING)):
        solved = jax.jit(native.solve, static_argnums=2)(expected, right, refinements)
        assert_same(solve_in_jax(expected, right, refinements), solved, tolerance)


@compiled
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_every_instruction_set_gives_the_same(shape, at_level):
    problem = random_lq(3, True, **shape)
    right = random_vector(problem, 4)
    expected = factor_in_jax(problem)
    at_level(native, "FACTOR", "SOLVE")
    assert_same(expected, native.factor(problem), ROUNDING)
    assert_same(solve_in_jax(expected, right, 2), native.solve(expected, right, 2), ROUNDING)


@compiled
def test_batch_elements_equal_single_problems():
    problems = [random_lq(seed, seed % 2 == 0) for seed in range(5)]
    saddle = dataclasses.replace(problems[1], hessian=problems[1].hessian.at[2, -1, -1].add(-1e3))
    problems[1] = saddle
    vectors = [random_vector(problem, 9) for problem in problems]
    stack = lambda trees: jax.tree.map(lambda *v: jnp.stack(v), *trees)  # noqa: E731

    def both(problem, vector):
        factored = riccati.factor(problem)
        return factored, riccati.solve(factored, vector)

    factors, found = jax.jit(jax.vmap(both))(stack(problems), stack(vectors))
    np.testing.assert_array_equal(jax.vmap(lambda f: f.definite)(factors), [i != 1 for i in range(5)])
    for element in (0, 2, 3, 4):
        alone = jax.jit(both)(problems[element], vectors[element])
        jax.tree.map(
            lambda a, b, element=element: np.testing.assert_array_equal(a, b[element]),
            alone,
            (factors, found),
        )
