"""Consistency of the filter: the normalised error squared (NEES) is chi-square over many flights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxscp.simulation import IMU, ErrorStateFilter, Odometry
from jaxscp.simulation.estimator import nominal_error

FLIGHTS, TICKS, DT = 200, 600, 0.005
DELAY = 1.15
"""Error of the covariance that the delayed correction is allowed: NEES at most 15 % above its bound."""


def truths():
    """A circle of 2 m at 0.8 rad/s with yaw at 0.8 rad/s: closed form, and its specific force in body axes."""
    t, w, r = DT * jnp.arange(TICKS + 1.0), 0.8, 2.0
    zero, one = jnp.zeros_like(t), jnp.ones_like(t)
    c, s = jnp.cos(w * t), jnp.sin(w * t)
    half = 0.5 * w * t
    columns = [r * c, r * s, one, -r * w * s, r * w * c, zero, jnp.cos(half), zero, zero, jnp.sin(half)]
    return jnp.stack([*columns, zero, zero, w * one], axis=1), jnp.array([-r * w**2, 0.0, 9.81])


def flight(key):
    """Normalised squared error and position error at the end, at samples of 200 Hz with odometry at 100 Hz."""
    unit, odometry, filter_ = IMU(), Odometry(drift=0.0), ErrorStateFilter()
    states, force = truths()
    keys = jax.random.split(key, TICKS + 2)
    bias = unit.init(keys[0])
    white = jax.random.normal(keys[1], (9,)) * jnp.repeat(jnp.array([0.01, 0.01, 0.3 * jnp.pi / 180.0]), 3)
    start = states[0].at[:6].add(white[:6])

    def tick(carry, inputs):
        key, number, truth = inputs
        estimate, sensor = carry
        first, second = jax.random.split(key)
        estimate = filter_.predict(estimate, unit.measure(first, force, truth[10:], bias), DT)

        def sample(carry):
            estimate, sensor = carry
            sensor, measured = odometry.measure(second, truth, sensor)
            fresh = filter_.correct(estimate, measured)
            # the pipeline begins with truths of no noise: leave them out
            return jax.tree.map(lambda a, b: jnp.where(number > 6, a, b), fresh, estimate), sensor

        return jax.lax.cond(number % 2 == 0, sample, lambda c: c, (estimate, sensor)), None

    inputs = (keys[2:], jnp.arange(1, TICKS + 1), states[1:])
    (estimate, _), _ = jax.lax.scan(tick, (filter_.init(start), odometry.init(states[0])), inputs)
    error = nominal_error(estimate, states[-1], bias)
    return error @ jnp.linalg.solve(estimate.covariance, error), jnp.linalg.norm(error[:3])


@pytest.mark.slow
def test_the_filter_is_consistent_and_better_than_its_measurements():
    nees, position = jax.tree.map(
        np.asarray, jax.jit(jax.vmap(flight))(jax.random.split(jax.random.key(0), FLIGHTS))
    )
    low, high = stats.chi2.ppf([0.0005, 0.9995], 15 * FLIGHTS) / FLIGHTS
    assert low < nees.mean() < DELAY * high
    assert np.median(position) < 0.01
