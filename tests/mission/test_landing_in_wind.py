"""Landings alone, in wind: the vehicle leans against it, and levels off just above the deck."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.mission import Choices, Phase, draw_case
from jaxscp.mission.cases import sent_off
from jaxscp.mission.craft import Record, nominal_pilot
from jaxscp.mission.outcome import assess
from jaxscp.simulation import Sensors, begin
from jaxscp.simulation.simulate import advance
from jaxscp.simulation.vehicles import FEET_DEPTH

WIND = 8.0  # m/s: hover leans by 15 degrees
LEVEL, SOFT, NEAR = 5.0, 0.5, 0.08  # degrees, m/s and m at the first contact, of the project's aims
SENT_OFF, PERIODS = 7.0, 1400  # s at which the deck begins to move, and 10 ms


def landing(case):
    """Up from the deck, and down again at once."""
    world, pilot, sensors = sent_off(case.world, SENT_OFF), nominal_pilot(), Sensors()
    deck = world.course.start.at[2].add(sensors.deck_filter.height + FEET_DEPTH)
    first = pilot.init(jnp.zeros(13).at[6].set(1.0).at[:3].set(deck))

    def fly(state, observation, time):
        waits = state.phase == int(Phase.hover)
        state = jax.tree.map(lambda a, b: jnp.where(waits, a, b), pilot.with_approach(state, time), state)
        return pilot(state, observation, time)

    loop = begin(world, sensors, first, case.key)
    loop, flight = eqx.filter_jit(lambda loop: advance(world, sensors, fly, loop, PERIODS))(loop)
    record, flight = Record(), jax.tree.map(np.asarray, flight)
    record.add(Phase(int(loop.controller.phase)), flight, np.full(len(flight.vehicle), np.inf))
    return assess(record, int(loop.controller.attempts), np.asarray(case.goal))


@pytest.mark.nightly
def test_the_vehicle_touches_the_deck_level():
    found = landing(draw_case("outdoor", 0, Choices(wind=WIND)))
    assert found.landed
    assert found.tilt < LEVEL
    assert found.vertical_speed < SOFT
    assert found.touchdown < NEAR
