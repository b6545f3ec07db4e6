"""Accuracy of a mesh, against SciPy's integration."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxscp.problem.node_values import typical_sizes
from jaxscp.scp import mesh
from jaxscp.transcription.interval_inputs import integration_inputs
from jaxscp.transcription.shooting import Grid, evaluate
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


@pytest.mark.parametrize("seed", [0, 1])
def test_bounded_intervals_are_those_that_the_fixed_steps_integrate_badly(seed):
    z = turning(seed, 1.0)
    errors = (np.asarray(evaluate(PROBLEM, z, GRID).end) - scipy_ends(z)) / np.asarray(typical_sizes(z))[:13]
    bad = np.linalg.norm(errors, axis=1) > mesh.ACCURACY
    assert bad.sum() > 0
    at_nodes = np.append(bad, False) | np.append(False, bad)
    np.testing.assert_array_equal(np.isfinite(mesh.bounds(PROBLEM, z, GRID)), at_nodes)


def test_intervals_within_their_bounds_are_accurate():
    z = turning(2, 1.5)
    for _ in range(4):
        z = z.at[:, -1].min(mesh.bounds(PROBLEM, z, GRID))
    assert np.all(np.isinf(mesh.bounds(PROBLEM, z, GRID)))
    assert z.shape[0] == NODES


def test_a_bound_leaves_the_least_dilation_room():
    low = mesh.bounded(PROBLEM, jnp.zeros(NODES))
    np.testing.assert_allclose(low.dilation_max, 2.0 * PROBLEM.dilation_min)
    free = mesh.bounded(PROBLEM, jnp.full(NODES, jnp.inf))
    np.testing.assert_allclose(free.dilation_max, PROBLEM.dilation_max)
