"""States and thrusts along a path, and the guess, compared with the equations of motion."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import scenarios
from jaxscp.dynamics import flatness, rotations
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import guess_time, initial_guess

ROUNDING = 1e-9
NODES = 30
BODY = jaxscp.airframes.paper_mav().body
ACCELERATIONS = [[0.0, 0.0, 0.0], [3.0, -2.0, 1.0], [9.0, 4.0, -3.0], [-1.0, 8.0, 6.0]]


@pytest.mark.parametrize("acceleration", ACCELERATIONS)
@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_thrust_along_the_attitude_is_the_acceleration(acceleration, yaw):
    acceleration = jnp.array([acceleration] * 3)
    attitude = flatness.attitudes(BODY, acceleration, jnp.stack([rotations.from_yaw(yaw)] * 3))
    still = jnp.zeros((3, 3))
    thrust = flatness.thrusts(BODY, acceleration, still, jnp.asarray(0.1))
    state = jnp.concatenate([still[0], still[0], attitude[1], still[0]])
    rate = BODY(state, thrust[1])
    np.testing.assert_allclose(rate[3:6], acceleration[1], atol=ROUNDING)
    np.testing.assert_allclose(rate[10:], 0.0, atol=ROUNDING)  # no torque
    np.testing.assert_allclose(jnp.linalg.norm(attitude, axis=1), 1.0, atol=ROUNDING)


def test_a_turn_has_its_rate_and_its_torque():
    rate, interval = jnp.array([0.3, -0.5, 0.8]), 1e-3
    time = interval * jnp.arange(5.0)
    half = 0.5 * time[:, None] * rate
    size = jnp.linalg.norm(half, axis=1, keepdims=True)
    attitude = jnp.concatenate([jnp.cos(size), half * jnp.sinc(size / jnp.pi)], axis=1)
    found = flatness.body_rates(attitude, jnp.asarray(interval))
    np.testing.assert_allclose(found[1:-1], jnp.stack([rate] * 3), rtol=1e-6)  # error of central differences
    thrust = flatness.thrusts(BODY, jnp.zeros((5, 3)), jnp.stack([rate] * 5), jnp.asarray(interval))
    torque = BODY.torque_map @ thrust[2]
    np.testing.assert_allclose(torque, jnp.cross(rate, BODY.inertia @ rate), atol=ROUNDING)


@pytest.mark.parametrize("force", [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
def test_no_axis_to_turn_about_gives_an_attitude_all_the_same(force):
    weightless = dataclasses.replace(BODY, gravity=jnp.zeros(3))
    found = flatness.attitudes(weightless, jnp.array([force]), rotations.from_yaw(1.0)[None])
    np.testing.assert_allclose(jnp.linalg.norm(found), 1.0, atol=ROUNDING)


GUESS = jax.jit(initial_guess)  # compiled once for each mission


def guess_of(scenario):
    allocation = allocate(scenario.route(), NODES)
    return GUESS(scenario, allocation), allocation


@pytest.mark.parametrize("mission", [scenarios.platform_to_platform, scenarios.ascent_to_platform])
@pytest.mark.slow
def test_the_guess_is_nearly_a_flight(mission):
    scenario = mission()
    guess, allocation = guess_of(scenario)
    np.testing.assert_allclose(guess.dilation, guess_time(scenario, allocation))
    interval = guess.dilation[0] / (NODES - 1)
    rate = jax.vmap(scenario.airframe.body)(guess.states, guess.controls)
    # trapezoid rule over an interval against the change of state; rates change within an interval
    change = jnp.diff(guess.states, axis=0) - 0.5 * interval * (rate[1:] + rate[:-1])
    moved = jnp.abs(jnp.diff(guess.states, axis=0))
    assert float(jnp.max(jnp.abs(change[:, :3]))) < 0.05 * float(jnp.max(moved[:, :3]))
    assert float(jnp.mean(jnp.abs(change[:, 3:6]))) < 0.2 * float(jnp.mean(moved[:, 3:6]))
    assert float(jnp.mean(jnp.abs(change[:, 6:10]))) < 0.4 * float(jnp.mean(moved[:, 6:10]))


@pytest.mark.parametrize("mission", [scenarios.platform_to_platform, scenarios.ascent_to_platform])
def test_the_guess_keeps_the_corridor_its_ends_and_thrust(mission):
    scenario = mission()
    guess, allocation = guess_of(scenario)
    cell = jnp.concatenate([allocation, allocation[-1:]])
    corridor = scenario.corridor
    beyond = jnp.einsum("nfi,ni->nf", corridor.normals[cell], guess.states[:, :3]) - corridor.offsets[cell]
    assert float(jnp.max(beyond)) < 0.02  # a thousandth of the route
    np.testing.assert_array_equal(guess.states[0], scenario.start.vector())
    np.testing.assert_array_equal(guess.states[-1], scenario.goal.vector())
    assert bool(jnp.all(guess.controls >= scenario.airframe.thrust_min))
    assert bool(jnp.all(guess.controls <= scenario.airframe.thrust_max))


def test_attitudes_do_not_jump_where_the_goal_is_written_with_the_other_sign():
    scenario = scenarios.platform_to_platform()
    other = dataclasses.replace(
        scenario, goal=dataclasses.replace(scenario.goal, attitude=-scenario.goal.attitude)
    )
    found = [guess_of(s)[0].states for s in (scenario, other)]
    np.testing.assert_allclose(*found, atol=ROUNDING)
