"""The wrench against hand formulas, gusts against their spectrum, motors against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from jaxscp.simulation import Aerodynamics, Deck, Dryden, Motors

ROUNDING = 1e-9
SPECTRUM = 0.15
"""Mean of 40 000 s in segments of 164 s: some 240 averages of 20 bins, 2 % each; Welch's leakage takes the rest."""
VARIANCE = 0.1
"""Some 5 000 correlation times of 8 s: 2 to 3 %."""

AIR = Aerodynamics()
LEVEL = jnp.zeros(13).at[6].set(1.0)
FAR = Deck(jnp.array([90.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array(128.5))
THRUSTS = jnp.full(4, 2.0)
wrench = jax.jit(lambda state, wind, deck: AIR.wrench(state, THRUSTS, wind, deck))


def test_drag_opposes_relative_wind_and_pitches_the_vehicle():
    state = LEVEL.at[2].set(50.0).at[3].set(3.0)
    force, torque = wrench(state, jnp.zeros(3), FAR)
    expected = -(0.045 * 4 * 2.0**0.5 + 0.5 * 1.2 * 0.01 * 3.0) * 3.0
    np.testing.assert_allclose(force, [expected, 0.0, 0.0], atol=1e-5)  # ground effect at 50 m: 3e-7 N
    np.testing.assert_allclose(torque, [0.0, 0.02 * expected, 0.0], atol=ROUNDING)
    moved, _ = wrench(state, jnp.array([3.0, 0.0, 0.0]), FAR)
    np.testing.assert_allclose(moved, 0.0, atol=1e-5)


def test_suction_falls_by_e_over_its_height():
    def pull(height):
        deck = Deck(jnp.array([0.0, 0.0, 9.0]), FAR.attitude, jnp.array(0.0))
        state = LEVEL.at[2].set(9.0 + 0.05 + height)
        effect = THRUSTS.sum() * (AIR.ground_effect(state[2]) + AIR.ground_effect(state[2] - 9.0))
        return effect - wrench(state, jnp.zeros(3), deck)[0][2]

    assert pull(0.0) == pytest.approx(2.2, abs=1e-4)  # no thrust of the carrier leaves 1e-6 m/s of inflow
    assert pull(0.0) / pull(0.25) == pytest.approx(np.e, rel=1e-4)


def test_inflow_is_the_momentum_theory_at_the_disk_and_twice_that_far_below():
    induced = np.sqrt(128.5 / (2.0 * 1.2 * np.pi * 0.6**2))
    at = jax.jit(lambda z: AIR.inflow(FAR, FAR.position + z * jnp.array([0.0, 0.0, 1.0]))[2])
    assert at(0.0) == pytest.approx(-induced, rel=1e-6)
    assert at(-60.0) == pytest.approx(-2.0 * induced, rel=1e-3)
    assert at(60.0) == pytest.approx(0.0, abs=1e-3)


def test_ground_effect_is_that_of_cheeseman_and_bennett():
    assert AIR.ground_effect(jnp.array(0.018)) == pytest.approx(1.0 / (1.0 - 1.0 / 16.0) - 1.0)
    assert AIR.ground_effect(jnp.array(-0.1)) == 0.0


def test_the_wrench_turns_with_the_world():
    """The whole scene turned by 90 degrees about z: the force turns, the torque in body axes stays."""
    half = 2.0**-0.5
    deck = Deck(jnp.array([0.3, 0.1, 0.8]), FAR.attitude, FAR.thrust)
    turned = Deck(jnp.array([-0.1, 0.3, 0.8]), jnp.array([half, 0.0, 0.0, half]), FAR.thrust)
    state = LEVEL.at[jnp.arange(6)].set(jnp.array([0.2, 0.0, 1.0, 1.0, 0.5, 0.1]))
    other = jnp.array([0.0, 0.2, 1.0, -0.5, 1.0, 0.1, half, 0.0, 0.0, half, 0.0, 0.0, 0.0])
    force, torque = wrench(state, jnp.array([2.0, 0.0, 0.0]), deck)
    force2, torque2 = wrench(other, jnp.array([0.0, 2.0, 0.0]), turned)
    np.testing.assert_allclose(force2, [-force[1], force[0], force[2]], atol=ROUNDING)
    np.testing.assert_allclose(torque2, torque, atol=ROUNDING)


@pytest.mark.slow
def test_gusts_have_drydens_spectrum_and_variance():
    gusts, dt = Dryden(wind=[8.0, 0.0, 0.0]), 0.02

    def fly(key):
        keys = jax.random.split(key, 100_001)
        step = lambda state, key: gusts.step(state, dt, key)  # noqa: E731
        return jax.lax.scan(step, gusts.init(keys[0]), keys[1:])[1]

    samples = np.asarray(jax.jit(jax.vmap(fly))(jax.random.split(jax.random.key(0), 20)))
    deviations = np.asarray(gusts.deviations())
    np.testing.assert_allclose(samples.var(axis=(0, 1)), deviations**2, rtol=VARIANCE)
    frequency, density = signal.welch(samples, 1.0 / dt, nperseg=8192, axis=1)
    band = (frequency > 0.02) & (frequency < 4.0)  # above: aliases of the sampled process
    formula = np.asarray(gusts.spectrum(jnp.asarray(frequency)))[:, band]
    ratio = density.mean(axis=0).T[:, band] / formula
    bins = ratio[:, : ratio.shape[1] // 20 * 20].reshape(3, -1, 20).mean(axis=2)
    assert np.abs(bins - 1.0).max() < SPECTRUM


def test_the_spectrum_integrates_to_the_variance():
    gusts = Dryden(wind=[5.0, 3.0, 0.0])
    frequency = jnp.geomspace(1e-6, 1e4, 20_000)
    total = np.trapezoid(np.asarray(gusts.spectrum(frequency)), np.asarray(frequency), axis=1)
    np.testing.assert_allclose(total, np.asarray(gusts.deviations()) ** 2, rtol=1e-3)


def test_a_motor_answers_after_its_delay_with_its_time_constant():
    motors, dt = Motors(thrust_min=[0.1] * 4, thrust_max=[6.25] * 4), 0.0025
    state, history = motors.init(), []
    step = jax.jit(lambda state: motors.step(state, jnp.full(4, 2.0), dt))
    for _ in range(40):
        state = step(state)
        history.append(float(state.thrusts[0]))
    time = dt * np.arange(1, 41)
    answer = 2.0 - 1.9 * np.exp(-np.maximum(time - 4 * dt, 0.0) / 0.03)
    np.testing.assert_allclose(history, answer, atol=ROUNDING)


def test_saturation_falls_with_load_and_charge():
    motors = Motors(thrust_min=[0.1] * 4, thrust_max=[6.25] * 4)
    fresh = motors.init()
    assert motors.greatest(fresh).max() < 6.25
    empty = jax.tree.map(lambda x: x, fresh)
    empty = type(fresh)(fresh.thrusts, fresh.waiting, jnp.ones(()))
    assert motors.greatest(empty)[0] / 6.25 == pytest.approx(0.83**2, rel=1e-2)
    assert motors.step(fresh, jnp.full(4, 99.0), 10.0).thrusts.max() <= 6.25
