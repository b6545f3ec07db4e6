"""The program of a tick against independent solvers, and what its iterates guarantee."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.control.bounded_qp import BoundedQP, solve
from tests.support.bounded_programs import solution_of_clarabel, solution_of_osqp

NODES, CONTROLS = 10, 4
SAME_SOLUTION = 1e-6  # OSQP's accuracy at that tolerance, for Hessians of condition number 1e4
ITERATIONS = 40  # far more than needed: slacks become rounding errors, and nothing may divide by them
SOLVE = jax.jit(lambda qp, guess, centre: solve(qp, guess, centre, ITERATIONS))


def random_program(seed, force=300.0, rate=0.8):
    """A random program whose solution meets bounds and rates; controls between 0.3 and 5, from 2."""
    random = np.random.default_rng(seed)
    jacobian = random.normal(size=(120, NODES * CONTROLS)) * np.geomspace(1.0, 0.1, NODES * CONTROLS)
    shape = (NODES, CONTROLS)
    return BoundedQP(
        jnp.asarray(jacobian.T @ jacobian),
        jnp.asarray(force * random.normal(size=shape)),
        jnp.full(CONTROLS, 2.0),
        jnp.stack([jnp.full(shape, 0.3), jnp.full(shape, -rate)]),
        jnp.stack([jnp.full(shape, 5.0), jnp.full(shape, rate)]),
    )


def solved(qp):
    start = jnp.full((NODES, CONTROLS), 2.0)
    return SOLVE(qp, start, start)


@pytest.mark.parametrize("reference", [solution_of_osqp, solution_of_clarabel])
@pytest.mark.parametrize("seed", range(3))
def test_the_solution_is_that_of_another_solver(reference, seed):
    qp = random_program(seed)
    found = solved(qp)
    active = np.isclose(found.v, qp.lower[0], atol=1e-6) | np.isclose(found.v, qp.upper[0], atol=1e-6)
    assert 0 < active.sum() < active.size
    np.testing.assert_allclose(found.v, reference(qp), atol=SAME_SOLUTION)
    assert float(found.residual) < 1e-9
    assert float(found.complementarity) < 1e-9


def test_every_iterate_keeps_all_limits():
    """From a guess far outside: so that an early end gives controls that may be applied."""
    centre = jnp.full((NODES, CONTROLS), 2.0)
    two_steps = jax.jit(lambda qp, guess: solve(qp, guess, centre, 2))
    for seed in range(5):
        qp = random_program(seed)
        found = two_steps(qp, centre + 10.0)
        rows = qp.rows(found.v)
        assert bool(jnp.all((rows >= qp.lower) & (rows <= qp.upper)))
        assert float(found.complementarity) > 1e-6


def test_without_limits_the_linear_system_is_solved():
    qp = random_program(0)
    free = jnp.full_like(qp.lower, jnp.inf)
    qp = BoundedQP(qp.hessian, qp.gradient, qp.before, -free, free)
    start = jnp.zeros((NODES, CONTROLS))
    found = SOLVE(qp, start, start)
    exact = -np.linalg.solve(np.asarray(qp.hessian), np.asarray(qp.gradient).ravel())
    np.testing.assert_allclose(found.v.ravel(), exact, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_derivatives_are_differences():
    """Reverse mode through all steps, in the gradient: the derivative of v is -H^-1 on the free directions."""
    qp, start = random_program(2), jnp.full((NODES, CONTROLS), 2.0)
    direction = jnp.asarray(np.random.default_rng(0).normal(size=(NODES, CONTROLS)))

    @jax.jit
    def value(size):
        moved = BoundedQP(qp.hessian, qp.gradient + size * direction, qp.before, qp.lower, qp.upper)
        return jnp.sum(solve(moved, start, start, 14).v ** 2)

    step = 1e-3
    difference = (value(step) - value(-step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(value)(0.0), difference, rtol=1e-5)
