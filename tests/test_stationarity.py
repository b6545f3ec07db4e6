"""The residual of the optimality conditions: its gradient, and the judge's own linearisation that it rests on."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.convexify import terminal_cost
from jaxscp.intervals import Grid, active_points, evaluate, linearise
from jaxscp.lagrangian import residual
from jaxscp.lifted import no_multipliers, path_multipliers
from jaxscp.relinearise import relinearise
from jaxscp.stationarity import lagrangian_gradient, stationarity
from tests.flights import random_nodes, short_problem

ROUNDING = 1e-9  # relative to the largest entry
FINE = Grid(substeps=80)  # fourth order: 4096 times as accurate as ten substeps
RK4_ERROR = 1e-7  # of that many, relative to the largest entry


def close(found, expected, tolerance):
    size = max(1.0, float(np.max(np.abs(expected))))
    np.testing.assert_allclose(found, expected, atol=tolerance * size)


@pytest.fixture(scope="module")
def point():
    """A problem, node variables, their linearisation and random multipliers of everything but the two ends."""
    problem, random = short_problem(), np.random.default_rng(0)
    z = random_nodes(problem, 1)
    linear = jax.jit(lambda z: linearise(problem, z, Grid()))(z)
    shapes = no_multipliers(problem, z, linear)
    y = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), shapes)
    links = y.links.at[0].set(0.0).at[-1].set(0.0)
    # The path has neither the dilation's limits, which come last, nor the last node's constraints.
    rows = y.rows.at[-1].set(0.0).at[:, -2:].set(0.0)
    y = eqx.tree_at(lambda m: (m.links, m.rows), y, (links, rows))
    return problem, z, linear, y


def test_gradient_is_that_of_the_lagrangian(point):
    """What two stages have of a node's controls adds up to the derivative by automatic differentiation."""
    problem, z, linear, y = point
    path, stage = path_multipliers(problem, linear, y), problem.variables

    def lagrangian(z):
        r = residual(evaluate(problem, z, Grid()), terminal_cost(problem, z), z)
        total = r.cost + jnp.vdot(path.flow, r.defect)
        for constraint, multiplier, values in zip(problem.constraints, path.values, r.values, strict=True):
            on = active_points(constraint, values.shape[1])[:, :, None]
            total -= jnp.sum(jnp.where(on, multiplier * values, 0.0))
        return total

    stages = lagrangian_gradient(problem, z, linear, y)
    nodes = stages[:, :stage].at[1:, problem.state_size :].add(stages[:-1, stage:])
    close(nodes, jax.jit(jax.grad(lagrangian))(z), ROUNDING)


def test_the_judges_linearisation_is_the_limit_of_the_solvers(point):
    problem, z, _, _ = point
    found = jax.jit(lambda z: relinearise(problem, z, Grid()))(z)
    expected = jax.jit(lambda z: linearise(problem, z, FINE))(z)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        close(a, b, RK4_ERROR)


def test_residual_is_relative_to_the_cost(point):
    """A random point is not stationary, and is as far from it when cost and multipliers are scaled together."""
    problem, z, linear, y = point
    cost = jnp.asarray(40.0)
    once = stationarity(problem, z, linear, y, cost)
    assert float(once) > 0.1
    heavier = eqx.tree_at(lambda p: p.weights, problem, jax.tree.map(lambda w: 3.0 * w, problem.weights))
    again = jax.jit(lambda z: linearise(heavier, z, Grid()))(z)
    thrice = stationarity(heavier, z, again, jax.tree.map(lambda v: 3.0 * v, y), 3.0 * cost)
    np.testing.assert_allclose(thrice, once, rtol=1e-9)
