"""The assessment on flights that are written by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.mission import Phase, assess
from jaxscp.mission.member import Record
from jaxscp.simulation import Flight

TICKS, RATE = 600, 200
GOAL = np.array([0.0, 0.0, 4.0])


def state(place, velocity=(0.0, 0.0, 0.0), tilt=0.0):
    """(13,) with a tilt about y in rad."""
    turn = [np.cos(0.5 * tilt), 0.0, np.sin(0.5 * tilt), 0.0]
    return np.concatenate([place, velocity, turn, np.zeros(3)])


def descent(tilt=0.0, offset=0.02, obstacle=2.0, below=0.0):
    """Down at 0.4 m/s from 1 m over a deck that moves at 0.5 m/s, then at rest on it."""
    record, time = Record(), np.arange(TICKS) / RATE
    carriers = np.stack([state([0.5 * t, 0.0, 2.0], (0.5, 0.0, 0.0)) for t in time])
    heights = np.maximum(1.0 - 0.4 * time, below)
    speeds = np.where(heights > below, -0.4, 0.0)
    leans = np.where(heights > below, tilt, 0.0)
    vehicles = np.stack(
        [
            state([0.5 * t + offset, 0.0, 2.21 + h], (0.5, 0.0, v), lean)
            for t, h, v, lean in zip(time, heights, speeds, leans, strict=True)
        ]
    )
    parts = vehicles, carriers, vehicles, np.zeros((TICKS, 6)), np.zeros((TICKS, 4))
    flight = Flight(*map(jnp.asarray, parts))
    record.add(Phase.landed, flight, np.full(TICKS, obstacle))
    return assess(record, 1, GOAL)


def test_a_landing_is_measured_relative_to_the_deck():
    outcome = descent()
    assert outcome.landed
    assert not outcome.collision
    assert outcome.touchdown == pytest.approx(0.02, abs=1e-9)
    assert outcome.vertical_speed == pytest.approx(0.4)
    assert outcome.tilt == pytest.approx(0.0, abs=1e-6)
    assert outcome.where == pytest.approx((0.02, 0.0))


def test_the_first_contact_is_that_of_the_lowest_foot():
    outcome = descent(tilt=0.25)
    assert outcome.tilt == pytest.approx(np.degrees(0.25), abs=1e-6)


@pytest.mark.parametrize("case", [{"obstacle": 0.1}, {"below": -0.1}])
def test_a_collision_is_no_landing(case):
    outcome = descent(**case)
    assert outcome.collision
    assert not outcome.landed


def test_a_landing_beside_the_point_is_none():
    assert not descent(offset=0.35).landed
