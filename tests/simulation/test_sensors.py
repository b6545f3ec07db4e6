"""Sensors: means, deviations, delays and drift of many samples against their stated numbers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.simulation import IMU, DeckSensor, LiDAR, Odometry, Scene

MANY = 4000
SPREAD = 0.05
"""Relative error of a standard deviation over some 4 000 samples: 1.1 %, times four."""
LEVEL = jnp.zeros(13).at[6].set(1.0)


def keys(seed, count=MANY):
    return jax.random.split(jax.random.key(seed), count)


def test_noise_and_bias_of_the_inertial_unit():
    unit, force = IMU(), jnp.array([0.0, 0.0, 9.81])
    bias = unit.init(jax.random.key(0))
    samples = np.asarray(jax.vmap(lambda k: unit.measure(k, force, jnp.zeros(3), bias))(keys(1)))
    deviation = np.array([0.05] * 3 + [0.005] * 3)
    np.testing.assert_allclose(samples.std(axis=0), deviation, rtol=SPREAD)
    truth = np.concatenate([np.asarray(force), np.zeros(3)]) + np.asarray(bias)
    assert (np.abs(samples.mean(axis=0) - truth) < 4.5 * deviation / MANY**0.5).all()


@pytest.mark.slow
def test_odometry_is_late_noisy_and_drifts_with_distance():
    odometry = Odometry()

    def walk(key):
        """80 m along x at 100 Hz and 8 m/s."""

        def step(state, inputs):
            key, x = inputs
            return odometry.measure(key, LEVEL.at[0].set(x).at[3].set(8.0), state)

        places = 0.08 * jnp.arange(1.0, 1001.0)
        state, samples = jax.lax.scan(step, odometry.init(LEVEL), (jax.random.split(key, 1000), places))
        return state.drift, samples[:, 0], samples[-1, 3:6]

    drift, x, velocity = jax.tree.map(np.asarray, jax.jit(jax.vmap(walk))(keys(2, 1000)))
    assert drift.std() == pytest.approx(0.005 * 80.0, rel=2 * SPREAD)
    assert x[:, 11].mean() == pytest.approx(10 * 0.08, abs=0.01)  # sample 12 shows truth 10
    assert velocity.std(axis=0) == pytest.approx(0.01, rel=2.5 * SPREAD)


def test_the_deck_is_seen_within_its_range_only():
    sensor = DeckSensor()
    measure = eqx.filter_jit(sensor.measure)

    def arrives(distance):
        state = sensor.init(jax.random.key(0))
        for i in range(3):
            place = jnp.array([0.0, 0.0, -distance])
            state, found = measure(jax.random.key(i), LEVEL, place, LEVEL[6:10], state)
        return found

    position, _, seen = arrives(1.9)
    assert seen
    np.testing.assert_allclose(position, [0.0, 0.0, -1.9], atol=5.0 * (0.005 + 0.002))
    assert not arrives(2.1)[2]


@pytest.mark.slow
def test_a_scan_shows_a_wall_and_loses_some_returns():
    wall = Scene(
        jnp.array([[5.0, 0.0, 0.0]]),
        jnp.array([[0.5, 50.0, 50.0]]),
        jnp.zeros((0, 2)),
        jnp.zeros(0),
        jnp.zeros(0),
    )
    lidar = LiDAR(jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0]), (MANY, 3)))
    points, seen = lidar.scan(jax.random.key(0), LEVEL.at[2].set(1.0), wall)
    points, seen = np.asarray(points), np.asarray(seen) > 0.5
    assert points[seen, 0].mean() == pytest.approx(4.5, abs=5 * 0.02 / MANY**0.5)
    assert points[seen, 0].std() == pytest.approx(0.02, rel=SPREAD)
    assert 1.0 - seen.mean() == pytest.approx(0.02, abs=5 * (0.02 / MANY) ** 0.5)
    assert (points[~seen] == 0.0).all()
