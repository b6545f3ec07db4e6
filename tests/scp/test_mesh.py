"""Accuracy of a mesh, against SciPy's integration."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxscp.problem.node_values import typical_sizes
from jaxscp.scp import mesh
from jaxscp.transcription.interval_inputs import integration_inputs
from jaxscp.transcription.shooting import Grid, evaluate, linearise
from tests.support.flights import NODES, random_nodes, short_problem

PROBLEM, GRID = short_problem(), Grid(3)
TIGHT = 1e-12  # of SciPy


def turning(seed, factor):
    """Random nodes with body rates of several rad/s, in intervals of a factor times the usual length."""
    z = random_nodes(PROBLEM, seed)
    return z.at[:, 10:13].multiply(3.0).at[:, -1].multiply(factor)


def scipy_ends(z):
    """End of every interval, by DOP853."""
    n, ends = PROBLEM.state_size, []
    for w in np.asarray(integration_inputs(PROBLEM, z)):
        first, last = np.split(w[n:], 2)

        def rate(tau, x, first=first, last=last):
            return np.asarray(PROBLEM.slope(jnp.asarray(x), jnp.asarray(first + (last - first) * tau)))[:n]

        ends.append(solve_ivp(rate, (0.0, 1.0), w[:n], "DOP853", rtol=TIGHT, atol=TIGHT).y[:, -1])
    return np.array(ends)


def transition(z, grid=GRID):
    """Derivative of every interval's end by its first state."""
    return linearise(PROBLEM, z, grid).jacobian.end[:, :, : PROBLEM.state_size]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1])
def test_bounded_intervals_are_those_whose_errors_are_large_at_some_node(seed):
    z = turning(seed, 1.0)
    errors = jnp.asarray(np.asarray(evaluate(PROBLEM, z, GRID).end) - scipy_ends(z))
    parts = np.asarray(mesh.carried_along(transition(z), errors) / typical_sizes(z)[:13])
    worst = np.linalg.norm(parts, axis=2).max(axis=0)
    bad = worst > mesh._level(jnp.asarray(worst))
    assert bad.sum() > 0
    at_nodes = np.append(bad, False) | np.append(False, bad)
    np.testing.assert_array_equal(np.isfinite(mesh.bounds(PROBLEM, z, GRID)), at_nodes)


def test_one_long_interval_is_free_while_the_flight_is_accurate_and_bounded_alone_where_it_is_not():
    z = turning(1, 0.3)
    for dilation, expected in ((1.0, []), (3.0, [3])):
        found = mesh.bounds(PROBLEM, z.at[3, -1].set(dilation), GRID)
        assert np.all(np.isin(expected, np.flatnonzero(np.isfinite(found))))
        assert np.isfinite(found).sum() <= 3 * len(expected), "of its two intervals at most"


def test_parts_of_the_intervals_add_up_to_the_error_of_the_flight():
    """The flight of a plan's controls by coarse steps, and the same by fine ones."""
    n, fine = PROBLEM.state_size, Grid(3, steps=8)
    coarse = exact = turning(0, 0.5)
    for i in range(NODES - 1):
        coarse = coarse.at[i + 1, :n].set(evaluate(PROBLEM, coarse, GRID).end[i])
        exact = exact.at[i + 1, :n].set(evaluate(PROBLEM, exact, fine).end[i])
    errors = evaluate(PROBLEM, coarse, GRID).end - evaluate(PROBLEM, coarse, fine).end
    missed = np.asarray(coarse - exact)[1:, :n]
    found = jnp.sum(mesh.carried_along(transition(coarse), errors), axis=1)
    np.testing.assert_allclose(found, missed, atol=1e-2 * np.abs(missed).max())  # to first order


def test_parts_brought_down_to_the_level_sum_to_the_accuracy():
    parts = mesh.ACCURACY * jnp.array([0.01, 3.0, 0.2, 0.0, 0.7])
    lowered = jnp.minimum(parts, mesh._level(parts))
    np.testing.assert_allclose(jnp.sum(lowered), mesh.ACCURACY)
    np.testing.assert_array_equal(lowered == parts, [True, False, True, True, False])


def test_a_flight_within_its_bounds_is_accurate():
    z = turning(2, 1.5)
    for _ in range(6):
        z = z.at[:, -1].min(mesh.bounds(PROBLEM, z, GRID))
    assert np.all(np.isinf(mesh.bounds(PROBLEM, z, GRID)))
    assert z.shape[0] == NODES


def test_a_bound_leaves_the_least_dilation_room():
    low = mesh.bounded(PROBLEM, jnp.zeros(NODES))
    np.testing.assert_allclose(low.dilation_max, 2.0 * PROBLEM.dilation_min)
    free = mesh.bounded(PROBLEM, jnp.full(NODES, jnp.inf))
    np.testing.assert_allclose(free.dilation_max, PROBLEM.dilation_max)


def test_the_level_holds_for_parts_of_very_different_sizes_and_beside_one_that_is_infinite():
    """One huge part and four small ones: the four keep theirs, the huge one gets what they leave."""
    small = 0.1 * mesh.ACCURACY
    for huge in (1e12, jnp.inf):
        level = mesh._level(jnp.array([small, small, huge, small, small]))
        np.testing.assert_allclose(level, 0.6 * mesh.ACCURACY, rtol=1e-12)
