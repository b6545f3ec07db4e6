"""Batches as accelerators plan them: unfinished elements in chunks. On a CPU, elements run alone unless a test asks."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.core import batching
from tests.support.own_problems import minimum_time

SCENARIO = jaxscp.scenarios.platform_to_platform()
PLANNER = jaxscp.Planner(nodes=12)
MASSES = jnp.linspace(0.9, 1.0, 5)
SAME = 1e-6  # relative: another order of sums, and as many digits as the default mode's stop gives


@pytest.fixture
def in_chunks(monkeypatch):
    """Two chunks, the second one padded."""
    monkeypatch.setitem(batching.CHUNK, "cpu", (3,))


def plan(mass):
    return PLANNER(eqx.tree_at(lambda s: s.airframe.body.mass, SCENARIO, mass))


def fastest(distance):
    problem = minimum_time(distance)
    return jaxscp.solve(problem, jaxscp.straight_line(problem, 2.0))


@pytest.mark.slow
def test_the_default_mode_is_a_batch_in_chunks(in_chunks):
    """No loop of a plan closes over an array. Such an array would belong to no element of the batch."""
    assert jax.eval_shape(jax.vmap(fastest), MASSES).cost.shape == MASSES.shape


@pytest.mark.nightly
def test_a_batch_in_chunks_plans_what_a_loop_plans(in_chunks):
    found = jax.jit(jax.vmap(plan))(MASSES)
    assert np.all(jaxscp.status_names(found.status) == "converged")
    for i, mass in enumerate(MASSES):
        np.testing.assert_allclose(found.cost[i], plan(mass).cost, rtol=SAME)
