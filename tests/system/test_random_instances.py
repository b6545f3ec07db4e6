"""A hundred random missions: an independent rollout of every plan ends at its goal."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxscp
from jaxscp import Status, status_names
from tests.support.random_instances import random_instances

DISTANCE = 1e-3  # m, largest error of a landing
ANGLE = np.radians(0.1)
COARSE = 2e-3  # relative: costs at the stops with coarse and with exact subproblems, neither optimal
MISSIONS = {
    "platform": jaxscp.scenarios.platform_to_platform,
    "ascend": jaxscp.scenarios.ascent_to_platform,
}


@pytest.mark.parametrize(
    "seed", [pytest.param(0, marks=pytest.mark.slow), pytest.param(1, marks=pytest.mark.nightly)]
)
def test_plans_land_where_they_say(seed):
    mission = list(MISSIONS.values())[seed]
    scenarios = random_instances(jax.random.key(seed), 50, mission)
    solutions = jax.jit(jax.vmap(jaxscp.Planner(method=jaxscp.PTR())))(scenarios)
    names = status_names(solutions.status)
    assert set(names) == {"converged"}, names
    assert np.max(solutions.certificate.error("final position")) < DISTANCE
    assert np.max(solutions.certificate.error("final attitude")) < ANGLE
    for leaf in jax.tree.leaves(solutions):
        assert np.all(np.isfinite(leaf))


@pytest.mark.nightly
def test_coarse_subproblems_end_where_exact_ones_do():
    scenarios = random_instances(jax.random.key(2), 50)
    methods = jaxscp.PTR(), jaxscp.PTR(initial_forcing=0.0)
    coarse, exact = (jax.jit(jax.vmap(jaxscp.Planner(method=method)))(scenarios) for method in methods)
    assert set(status_names(coarse.status)) == set(status_names(exact.status)) == {"converged"}
    np.testing.assert_allclose(coarse.cost, exact.cost, rtol=COARSE)
    steps = [int(jnp.sum(s.history.conic_iterations)) for s in (coarse, exact)]
    assert steps[1] > 1.5 * steps[0]


@pytest.mark.parametrize(
    "name",
    [pytest.param("platform", marks=pytest.mark.slow), pytest.param("ascend", marks=pytest.mark.nightly)],
)
@pytest.mark.parametrize(
    "method",
    [jaxscp.PTR(), pytest.param(jaxscp.NewtonSCP(), marks=pytest.mark.nightly)],
    ids=["paper", "newton"],
)
def test_scipy_lands_where_the_plan_says(name, method):
    """SciPy's DOP853 integrates the controls, independent of the certificate's integrator."""
    scenario = MISSIONS[name]()
    solution = jaxscp.Planner(method=method)(scenario)
    assert bool(solution.status == Status.converged)
    plan, body = solution.trajectory, scenario.airframe.body
    rate = jax.jit(lambda t, x: body(x, plan.control_at(t)))
    state = np.asarray(plan.state[0])
    for start, end in zip(plan.time[:-1], plan.time[1:], strict=True):  # controls have kinks at the nodes
        flown = solve_ivp(rate, (float(start), float(end)), state, method="DOP853", rtol=1e-10, atol=1e-10)
        state = flown.y[:, -1]
    goal = scenario.goal
    assert np.linalg.norm(state[:3] - goal.position) < DISTANCE
    overlap = abs(np.dot(state[6:10], goal.attitude)) / np.linalg.norm(state[6:10])
    assert 2.0 * np.arccos(min(overlap, 1.0)) < ANGLE
