"""The deck's filter against the truth: a deck at constant velocity, delayed sights, messages with a drift."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.simulation import DeckFilter

PERIODS, DT = 400, 0.01
DRIFT = jnp.array([0.3, -0.2, 0.1])
"""m: of the carrier's frame against the vehicle's."""
ROUNDING = 1e-3
"""m: the filter's transient after 4 s, without noise."""


def deck_at(time):
    return jnp.array([0.3, -0.4, 1.0]) + time * jnp.array([0.8, 0.2, 0.0])


def vehicle_at(time):
    yaw = 0.3 * time
    turn = jnp.zeros(4).at[0].set(jnp.cos(0.5 * yaw)).at[3].set(jnp.sin(0.5 * yaw))
    place = jnp.array([0.0, 0.0, 2.0]) + time * jnp.array([0.7, 0.3, 0.0])
    return jnp.concatenate([place, jnp.array([0.7, 0.3, 0.0]), turn, jnp.array([0.0, 0.0, 0.3])])


def in_body(vehicle, point):
    w, z = vehicle[6], vehicle[9]
    c, s = w * w - z * z, 2.0 * w * z
    d = point - vehicle[:3]
    return jnp.stack([c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2]])


@jax.jit
def run(sight, noise, key):
    """Estimate after 4 s, with sights (or not) and noise in m."""
    filter_ = DeckFilter()
    level = jnp.array([1.0, 0.0, 0.0, 0.0])

    def period(deck, inputs):
        count, key = inputs
        now = DT * count.astype(float)
        deck = filter_.predict(deck, vehicle_at(now), DT)
        old = now - DT * filter_.delay
        relative = in_body(vehicle_at(old), deck_at(old)) + noise * jax.random.normal(key, (3,))
        deck = filter_.see(deck, relative, level, sight & (count % 3 == 0) & (count > 10))
        sent = now - filter_.message_delay
        place = deck_at(sent) + DRIFT - jnp.array([0.0, 0.0, filter_.height])
        message = jnp.concatenate([place, jnp.array([0.8, 0.2, 0.0]), level])
        heard = filter_.hear(deck, message)
        deck = jax.tree.map(lambda a, b: jnp.where(count % 10 == 0, a, b), heard, deck)
        return deck, None

    first = filter_.init(vehicle_at(0.0), deck_at(0.0) + 0.1)
    inputs = (jnp.arange(1, PERIODS + 1), jax.random.split(key, PERIODS))
    return jax.lax.scan(period, first, inputs)[0]


def test_a_deck_in_sight_is_found_whatever_the_drift():
    deck = run(jnp.array(True), 0.0, jax.random.key(0))
    np.testing.assert_allclose(deck.position, deck_at(4.0), atol=ROUNDING)
    np.testing.assert_allclose(deck.velocity, [0.8, 0.2, 0.0], atol=ROUNDING)
    assert float(deck.unseen) < 0.03


def test_out_of_sight_the_carriers_messages_count():
    deck = run(jnp.array(False), 0.0, jax.random.key(0))
    np.testing.assert_allclose(deck.position, deck_at(4.0) + DRIFT, atol=0.02)
    assert float(deck.unseen) == pytest.approx(4.0)


def test_noise_is_averaged():
    errors = [
        np.asarray(run(jnp.array(True), 0.006, key).position - deck_at(4.0))
        for key in jax.random.split(jax.random.key(1), 20)
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 0.005  # of 6 mm; the walk of the odometry forbids more
