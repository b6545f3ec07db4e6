"""Closed loops: hover over the deck, and the paper's take-off against suction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.simulation import Geometric, Sensors, World, simulate, simulated_mav

TICKS = 600
WORLD, SENSORS = World.of(), Sensors()
HOVER_ERROR = 0.15
"""m: the integral is still at work after 3 s; odometry drifts 5 mm over a metre."""


@pytest.fixture(scope="module")
def climb():
    """A compiled flight of 3 s: climb to a height over the deck under suction of F0 newtons, from a start height."""
    pilot = Geometric(simulated_mav())
    deck = WORLD.course.start + jnp.array([0.0, 0.0, 0.21])

    def flight(suction, command, integral_gain, height):
        world = eqx.tree_at(lambda w: w.air.suction, WORLD, suction)
        own = eqx.tree_at(lambda p: p.integral_gain, pilot, integral_gain)
        target = deck.at[2].add(command)

        def controller(integral, observation, time):
            return own(integral, observation.state(), target, jnp.zeros(3), 0.01)

        return simulate(world, SENSORS, (controller, jnp.zeros(3)), jax.random.key(0), TICKS, height)

    compiled = jax.jit(flight)
    return lambda *numbers: jax.tree.map(np.asarray, compiled(*map(jnp.asarray, numbers)))


@pytest.mark.nightly
def test_the_vehicle_hovers_over_the_deck_on_estimates_alone(climb):
    flight = climb(2.2, 1.0, 3.0, 1.0)
    last = flight.vehicle[-100:]
    assert np.abs(last[:, 2] - 3.21).max() < HOVER_ERROR
    assert np.abs(last[:, :2]).max() < HOVER_ERROR
    assert np.abs(flight.estimate[:, :3] - flight.vehicle[:, :3]).max() < 0.05
