"""Inputs that are unusual or wrong, each beside a sound one: a true plan, or a status that says what ended it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from tests.support.rooms import put, room, with_faces_scaled

PLANNER = jaxscp.Planner()
NEARLY_EQUAL = 1e-3
"""Of the cost. Another program rounds differently, and two of ten such pairs end at optima that are 5e-4 apart."""


def status(solution):
    return jaxscp.status_names(solution.status)


def position(solution):
    return np.asarray(solution.trajectory.state[:, :3])


@pytest.mark.nightly
def test_faces_of_any_length_give_the_same_plan():
    low = room(upper=(11.0, 5.0, 1.6))
    expected = PLANNER(low)
    found = PLANNER(with_faces_scaled(low, [1.0, 1.0, 1e-4, 1.0, 1.0, 3.0]))
    assert status(expected) == status(found) == "converged"
    np.testing.assert_allclose(position(found), position(expected), atol=1e-6)
    assert position(found)[:, 2].max() < 1.6


@pytest.mark.nightly
def test_a_quaternion_nearly_of_unit_norm_is_an_attitude():
    plan = PLANNER(put(room(), lambda s: s.start.attitude, [1.0009, 0.0, 0.0, 0.0]))
    assert status(plan) == "converged"
    np.testing.assert_allclose(plan.trajectory.state[0, 6:10], [1.0, 0.0, 0.0, 0.0], atol=1e-9)
    assert float(plan.certificate.error("final position")) < 1e-3


@pytest.mark.nightly
def test_a_subproblem_that_is_not_solved_is_no_iteration_limit():
    """On the ceiling, corridor and landing cone leave the last nodes one point."""
    touching, below = (PLANNER(room(goal=(6.0, 1.0, height))) for height in (5.0, 4.95))
    assert status(touching) == "insufficient_progress"
    assert int(touching.iterations) < PLANNER.method.max_iterations
    assert "landing cone" in touching.report()
    assert status(below) == "converged"


@pytest.mark.slow
def test_a_replan_through_another_corridor_has_its_polytopes():
    scenario = jaxscp.scenarios.platform_to_platform()
    plan = PLANNER.replan(PLANNER(room()), scenario)
    assert status(plan) == "converged"
    assert np.unique(plan.context).tolist() == list(range(scenario.corridor.count))
    np.testing.assert_allclose(position(plan)[0], scenario.start.position, atol=1e-6)


@pytest.mark.nightly
def test_a_trajectory_is_replanned_like_its_solution():
    plan, moved = PLANNER(room()), room(goal=(6.2, 1.0, 1.0))
    from_solution, from_trajectory = PLANNER.replan(plan, moved), PLANNER.replan(plan.trajectory, moved)
    assert status(from_solution) == status(from_trajectory) == "converged"
    np.testing.assert_allclose(position(from_trajectory), position(from_solution), atol=1e-9)


@pytest.mark.nightly
def test_no_zones_and_no_elements():
    empty = jaxscp.ellipsoids(np.zeros((0, 3)), [])
    zones = dataclasses.replace(room(), keep_out=empty, gates=empty)
    with_none, without = PLANNER(zones), PLANNER(room())
    assert status(with_none) == status(without) == "converged"
    np.testing.assert_allclose(with_none.cost, without.cost, rtol=NEARLY_EQUAL)

    def plan(mass):
        return PLANNER(put(room(), lambda s: s.airframe.body.mass, mass))

    none = jax.vmap(plan)(jnp.zeros(0))
    assert none.cost.shape == (0,)
    assert none.trajectory.state.shape == (0, 30, 13)
