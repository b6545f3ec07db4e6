"""The guess of a re-plan meets the new ends, and is the plan itself where nothing changed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.landing.warm_guess import warm_guess

NODES = 7
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def scenario():
    return jaxscp.scenarios.platform_to_platform()


@pytest.fixture(scope="module")
def plan(scenario):
    """From end to end of the scenario, with unit quaternions; it need not be a motion."""
    random = np.random.default_rng(0)
    state = random.standard_normal((NODES, 13))
    state[:, 6:10] /= np.linalg.norm(state[:, 6:10], axis=1, keepdims=True)
    state[0], state[-1] = scenario.start.vector(), scenario.goal.vector()
    ones = jnp.ones(NODES)
    return jaxscp.Trajectory(
        jnp.linspace(0.0, 2.0, NODES), jnp.asarray(state), jnp.ones((NODES, 4)), 2.0 * ones
    )


@pytest.mark.parametrize("yaw", [0.0, 1.0, -3.03, np.pi])
def test_meets_both_ends(scenario, plan, yaw):
    start = jaxscp.at_rest(np.asarray(scenario.start.position) + 0.1, yaw)
    moved = dataclasses.replace(scenario, start=start)
    found = jax.jit(warm_guess)(moved, plan)
    for state, wanted in ((found.state[0], start.vector()), (found.state[-1], scenario.goal.vector())):
        np.testing.assert_allclose(state[:6], wanted[:6], atol=ROUNDING)
        np.testing.assert_allclose(abs(jnp.dot(state[6:10], wanted[6:10])), 1.0, atol=ROUNDING)
        np.testing.assert_allclose(state[10:], wanted[10:], atol=ROUNDING)
    np.testing.assert_allclose(jnp.linalg.norm(found.state[:, 6:10], axis=1), 1.0, atol=ROUNDING)


def test_leaves_a_plan_of_the_same_scenario(scenario, plan):
    found = jax.jit(warm_guess)(scenario, plan)
    np.testing.assert_allclose(found.state, plan.state, atol=ROUNDING)


def test_free_components_stay(scenario, plan):
    free = dataclasses.replace(
        scenario,
        start=jaxscp.at_rest([9.0, 9.0, 9.0], 1.0),
        start_fixed=jaxscp.fixed(position=0, attitude=[1, 1, 0]),
    )
    found = jax.jit(warm_guess)(free, plan)
    np.testing.assert_allclose(found.state[0, :3], plan.state[0, :3], atol=ROUNDING)
    np.testing.assert_allclose(found.state[0, 6:10], plan.state[0, 6:10], atol=ROUNDING)
