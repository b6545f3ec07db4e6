"""Flights of the pilot under MJX: no truth reaches it, it starts against suction, and it lands."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.mission import Choices, Phase, Pilot, draw_case, run_mission
from jaxscp.mission.member import nominal_pilot
from jaxscp.simulation import IMU, Aerodynamics, Odometry, Sensors, World, advance, begin
from jaxscp.simulation.vehicles import FEET_DEPTH

WORLD = World.of()
DECK = jnp.array([0.0, 0.0, 2.16 + FEET_DEPTH])


class DeafUnit(IMU):
    """An inertial unit that reports rest, whatever the truth."""

    def measure(self, key, specific_force, body_rate, bias):
        return jnp.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])


class DeafOdometry(Odometry):
    """An odometry that reports its first place, whatever the truth."""

    def measure(self, key, truth, state):
        return state, state.waiting[0]


def deaf_sensors():
    sensors = Sensors(imu=DeafUnit(), odometry=DeafOdometry(), carrier=DeafOdometry(delay=1))
    return eqx.tree_at(lambda s: s.deck.greatest_range, sensors, jnp.zeros(()))


@pytest.fixture(scope="module")
def thrusts():
    """Commands of two seconds, from the deck, with sensors that report nothing of the world."""
    pilot, sensors = nominal_pilot(), deaf_sensors()

    def flight(world):
        first = pilot.init(jnp.zeros(13).at[6].set(1.0).at[:3].set(DECK))

        loop = begin(world, sensors, first, jax.random.key(0))

        def period(loop, _):
            loop, _ = advance(world, sensors, pilot, loop, 1)
            return loop, loop.command

        return jax.lax.scan(period, loop, None, length=200)[1]

    return eqx.filter_jit(flight)


@pytest.mark.nightly
def test_no_truth_reaches_the_pilot(thrusts):
    """Another air and another vehicle change the truth, not one bit of the commands."""
    first = np.asarray(thrusts(WORLD))
    air = dataclasses.replace(WORLD.air, suction=jnp.asarray(0.3), drag_area=jnp.asarray(0.1))
    other = eqx.tree_at(lambda w: (w.air, w.gusts.wind), WORLD, (air, jnp.array([5.0, 0.0, 0.0])))
    assert np.array_equal(first, np.asarray(thrusts(other)))
    assert first.max() > 1.0  # the pilot does something


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1])
def test_a_mission_lands(seed):
    mission = run_mission("indoor", seed, Choices(deck_speed=0.5))
    outcome = mission.outcome
    assert outcome.landed
    assert not outcome.collision
    assert outcome.touchdown < 0.08
    assert outcome.vertical_speed < 0.5
    assert mission.record.phases[-1] == Phase.landed


@pytest.mark.nightly
@pytest.mark.parametrize(
    "seed", [303, 1067], ids=["deck out of the sensor's reach", "stopped beside a trunk"]
)
def test_a_mission_outdoors_that_once_failed_lands(seed):
    mission = run_mission("outdoor", seed)
    assert mission.accomplished
    assert mission.outcome.attempts <= 2


@pytest.mark.slow
def test_a_pilot_is_a_pytree_of_arrays():
    pilot = nominal_pilot()
    assert isinstance(pilot, Pilot)
    doubled = jax.tree.map(lambda x: 2.0 * x if eqx.is_inexact_array(x) else x, pilot)
    assert float(doubled.rules.start_height) == 2.0 * float(pilot.rules.start_height)


@pytest.mark.slow
def test_cases_have_a_free_goal_and_a_deck_that_waits():
    case = draw_case("outdoor", 2)
    assert float(case.scene.distance(case.goal)) > 1.0
    place, velocity, _ = case.world.course.at(jnp.asarray(30.0))
    np.testing.assert_allclose(place, case.field.home, atol=1e-9)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-12)
    assert isinstance(case.world.air, Aerodynamics)
