"""The observer is a Kalman filter in its steady state; the compensation balances a disturbance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import jaxscp
from jaxscp.control import NMPC, Actuators, DisturbanceModel, Tracking
from jaxscp.control.disturbance import Observed, compensation, update

TICK = 0.01
BODY = jaxscp.airframes.paper_mav().body


@eqx.filter_jit
def at_hover(body):
    """Compensation at hover."""
    hover = jaxscp.at_rest([0.0, 0.0, 1.0]).vector()
    model = DisturbanceModel.of(body)
    return compensation(body, model, Tracking.of(body), hover, jnp.full(4, body.mass * 9.81 / 4), 0.0)


@pytest.mark.parametrize("drift", [0.01, 1.0, 30.0])
def test_the_gains_are_those_of_the_riccati_equation(drift):
    """State (y, tick d), unit noise of y, random walk of tick d."""
    model = DisturbanceModel([[0.0], [1.0]], noise=[0.02], drift=[drift])
    alpha, beta = model.gains(TICK)
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    walk = np.diag([0.0, (drift * TICK**1.5) ** 2])
    noise = np.array([[0.02**2]])
    seen = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(transition.T, seen.T, walk, noise)
    gain = covariance @ seen.T / (seen @ covariance @ seen.T + noise)
    np.testing.assert_allclose([alpha[0], beta[0]], gain[:, 0], rtol=1e-6)


def test_the_estimate_converges_to_a_constant_disturbance():
    """Exactly, without noise: a mass under gravity that the model does not know."""
    model, force = DisturbanceModel([[0.0], [1.0]], noise=[0.02], drift=[1.0]), 3.0
    observed, velocity = Observed(jnp.zeros(1), jnp.zeros(1)), 0.0
    step = jax.jit(lambda observed, change, state: update(model, TICK, observed, change, state))
    for _ in range(300):
        change = jnp.array([0.0, TICK * float(observed.disturbance[0])])
        velocity += TICK * force
        observed = step(observed, change, jnp.array([0.0, velocity]))
    np.testing.assert_allclose(observed.disturbance, [force], rtol=1e-6)


def test_wind_at_hover_is_met_by_a_tilt_and_weight_by_thrust():
    found = at_hover(BODY)
    weight = float(BODY.mass) * 9.81
    # half the tilt's angle, about y for a force along x; SOFTNESS leaves one per cent
    np.testing.assert_allclose(found[8, 0], -0.5 / weight, rtol=0.01)
    np.testing.assert_allclose(found[13:, 2], np.full(4, -0.25), rtol=0.01)
    np.testing.assert_allclose(BODY.torque_map @ found[13:, 3:], -np.eye(3), atol=0.01)
    np.testing.assert_allclose(found[:6], 0.0, atol=1e-12)


def test_dynamics_without_disturbances_have_none():
    nmpc = NMPC(jaxscp.DoubleIntegrator(1), Actuators([-1.0], [1.0]))
    target = nmpc.hold(jnp.zeros(2), jnp.zeros(1))
    assert nmpc.init(target, jnp.zeros(2)).disturbance.shape == (0,)
