"""The place that a phase flies to, while the deck is out of sight."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.mission import Phase
from jaxscp.mission.rules import Rules
from jaxscp.mission.targets import Target, advance
from jaxscp.simulation import Observation, Sensors
from jaxscp.simulation.simulate import CONTROL

RULES = Rules()
START = jnp.zeros(13).at[6].set(1.0).at[2].set(2.0)
SECONDS = 25.0


@pytest.fixture(scope="module")
def places():
    """Targets of an approach that sees the deck or not, from 2 m over it."""
    sensors = Sensors()

    @eqx.filter_jit
    def flown(unseen):
        deck = sensors.deck_filter.init(START, jnp.zeros(3))
        deck = eqx.tree_at(lambda d: d.unseen, deck, unseen)
        observation = Observation(sensors.estimator.init(START), deck)
        phase, push = jnp.asarray(int(Phase.approach)), jnp.zeros(3)

        def period(target, time):
            new = advance(RULES, phase, target, observation, time, push)
            return new, new.position

        times = CONTROL * jnp.arange(1.0, 1.0 + SECONDS / CONTROL)
        return jax.lax.scan(period, Target(START[:3], jnp.zeros(3)), times)[1]

    return lambda unseen: np.asarray(flown(jnp.asarray(unseen)))


def test_an_approach_that_sees_the_deck_waits_over_it(places):
    seen = places(0.0)
    assert np.abs(seen[-1, :2]).max() < 1e-3
    assert seen[-1, 2] == pytest.approx(float(RULES.approach_height), abs=0.1)


def test_an_approach_that_sees_no_deck_looks_around_and_below(places):
    """By drift the deck may lie beside its estimate, or under the reach of the deck sensor."""
    blind, seen = places(100.0), places(0.0)
    radius = float(RULES.search_rate) * SECONDS
    assert np.linalg.norm(blind[-500:, :2], axis=1).max() == pytest.approx(radius, rel=0.1)
    assert seen[-1, 2] - blind[-1, 2] == pytest.approx(float(RULES.search_depth), abs=0.02)
    assert blind[:, 2].min() > 0.0  # it stays over the deck where that is right
