"""The residual of the optimality conditions: the gradient, and the verifier's gradient."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.transcription.gradient import gradient_by
from jaxscp.transcription.lagrangian import lagrangian, no_multipliers
from jaxscp.transcription.shooting import Grid, evaluate, linearise
from jaxscp.transcription.stationarity import lagrangian_gradient, stationarity
from jaxscp.verification.integrator.method import eighth_order
from tests.support.flights import random_nodes, short_problem

ROUNDING = 1e-9  # relative to the largest entry
FINE = Grid(steps=4)  # sixth order: 4096 times as accurate as one step
RK6_ERROR = 1e-7  # error of that many steps, relative to the largest entry


def close(found, expected, tolerance):
    size = max(1.0, float(np.max(np.abs(expected))))
    np.testing.assert_allclose(found, expected, atol=tolerance * size)


@pytest.fixture(scope="module")
def point():
    """A problem, node variables, their linearisation and random multipliers."""
    problem, random = short_problem(), np.random.default_rng(0)
    z = random_nodes(problem, 1)
    linear = jax.jit(lambda z: linearise(problem, z, Grid()))(z)
    shapes = no_multipliers(problem, z, Grid())
    y = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), shapes)
    return problem, z, linear, y


def test_gradient_is_that_of_the_lagrangian(point):
    problem, z, linear, y = point
    expected = jax.jit(jax.grad(lambda z: lagrangian(problem, z, evaluate(problem, z, Grid()), y)))(z)
    close(lagrangian_gradient(problem, z, linear, y), expected, ROUNDING)


def test_the_verifiers_gradient_is_the_limit_of_the_solvers(point):
    problem, z, _, y = point
    found = jax.jit(lambda z: gradient_by(eighth_order(), problem, z, y, Grid()))(z)
    fine = jax.jit(lambda z: linearise(problem, z, FINE))(z)
    close(found, lagrangian_gradient(problem, z, fine, y), RK6_ERROR)


def test_residual_is_relative_to_the_cost(point):
    """A random point is not stationary; the residual is unchanged if cost and multipliers scale together."""
    problem, z, linear, y = point
    cost = jnp.asarray(40.0)
    first_order_only = stationarity(lagrangian_gradient(problem, z, linear, y), z, cost)
    assert float(first_order_only) > 0.1
    weights = jax.tree.map(lambda w: 3.0 * w, problem.cost.parameters)
    heavier = eqx.tree_at(lambda p: p.cost.parameters, problem, weights)
    again = jax.jit(lambda z: linearise(heavier, z, Grid()))(z)
    threefold = lagrangian_gradient(heavier, z, again, jax.tree.map(lambda v: 3.0 * v, y))
    thrice = stationarity(threefold, z, 3.0 * cost)
    np.testing.assert_allclose(thrice, first_order_only, rtol=1e-9)
