"""All requirements beyond corridor, cone and thrust in one scenario, checked on a rollout of the plan.

The tests evaluate the limits from their definitions, not by the constraint functions.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import Planner, scenarios, status_names
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.verification.rollout import rollout
from tests.support.flights import problem_over_scaled_time

pytestmark = pytest.mark.nightly

SPEED, TILT, BODY_RATE, THRUST_RATE = 3.5, 0.7, 3.0, 40.0
BALL, BALL_RADIUS = np.array([3.0, 2.0, 4.4]), 0.4
GATE, GATE_RADIUS = np.array([2.2, 0.8, 2.2]), 0.15
DECK_VELOCITY = np.array([0.3, -0.1, 0.1])
RELATIVE = 1.001  # limits hold to a thousandth
MILLIMETRE = 1e-3


@pytest.fixture(scope="module")
def planned():
    """A plan, and the rollout of its controls by an adaptive integrator."""
    scenario = dataclasses.replace(
        scenarios.ascent_to_platform(),
        obstacles=None,
        limits=jaxscp.flight_limits(speed=SPEED, tilt=TILT, body_rate=BODY_RATE, thrust_rate=THRUST_RATE),
        keep_out=jaxscp.ellipsoids([BALL], BALL_RADIUS),
        gates=jaxscp.ellipsoids([GATE], GATE_RADIUS),
        deck_velocity=jnp.asarray(DECK_VELOCITY),
        goal_fixed=jaxscp.fixed(attitude=[1, 1, 0]),
    )
    planner = Planner(nodes=20)
    solution = planner(scenario)
    problem = problem_over_scaled_time(scenario, planner.nodes_for(scenario))
    flight = jax.jit(lambda t: rollout(problem, t, 100))(solution.trajectory)
    return scenario, solution, flight


def test_every_limit_holds_on_the_whole_flight(planned):
    _, solution, flight = planned
    assert status_names(solution.status) == "converged"
    state = np.asarray(flight.state).reshape(-1, 13)
    assert np.linalg.norm(state[:, 3:6], axis=1).max() < SPEED * RELATIVE
    assert np.linalg.norm(state[:, 10:], axis=1).max() < BODY_RATE * RELATIVE
    upward = np.asarray(jax.vmap(rotation_matrix)(flight.state.reshape(-1, 13)[:, 6:10]))[:, 2, 2]
    assert np.arccos(upward).max() < TILT * RELATIVE
    change = np.abs(np.diff(flight.control, axis=1)) / np.diff(flight.time, axis=1)[:, :, None]
    assert change.max() < THRUST_RATE * 1.01  # difference quotient over a hundredth of an interval
    assert np.linalg.norm(state[:, :3] - BALL, axis=1).min() > BALL_RADIUS - MILLIMETRE


def test_it_passes_the_gate(planned):
    _, _, flight = planned
    distance = np.linalg.norm(np.asarray(flight.state)[:, :, :3] - GATE, axis=2)
    assert distance.min() < GATE_RADIUS + MILLIMETRE


def test_it_lands_on_the_moving_deck_with_any_heading(planned):
    scenario, _, flight = planned
    end, time = np.asarray(flight.state[-1, -1]), float(flight.time[-1, -1])
    deck = np.asarray(scenario.goal.position) + DECK_VELOCITY * time
    assert np.linalg.norm(end[:3] - deck) < MILLIMETRE
    np.testing.assert_allclose(end[3:6], DECK_VELOCITY, atol=5e-3)
    np.testing.assert_allclose(rotation_matrix(jnp.asarray(end[6:10]))[:, 2], [0.0, 0.0, 1.0], atol=2e-3)


def test_each_limit_is_felt(planned):
    """Each limit is active at one point at least; otherwise the other tests would be weak."""
    _, _, flight = planned
    state = np.asarray(flight.state).reshape(-1, 13)
    assert np.linalg.norm(state[:, 3:6], axis=1).max() > 0.97 * SPEED
    assert np.linalg.norm(state[:, 10:], axis=1).max() > 0.9 * BODY_RATE
    assert np.linalg.norm(state[:, :3] - BALL, axis=1).min() < BALL_RADIUS + 0.05
