"""The same controller hovers, starts against suction, flies a plan and lands."""

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from tests.control.test_bounded_qp import solution_of_osqp
from tests.support import closed_loop
from tests.support.closed_loop import NOISE, Plant, suction
from tests.support.flights_under_control import (
    AIRFRAME,
    CALM,
    HOVER,
    MOTORS,
    ROUGH,
    adaptive_plan,
    controller,
    flight,
    flight_along,
    heavy,
    program_of,
    tracking_error,
    uniform_plan,
)

NMPC = controller()
SUCTION = 2.9, 0.25  # N, m: a stiffness of -11.6 N/m at the deck
SAME_THRUST = 1e-4  # N: OSQP's accuracy at its tolerance; the cost is flat in some directions


KEY = jax.random.key(0)


def at(height):
    return jaxscp.at_rest([0.0, 0.0, height]).vector()


def hold(height):
    return NMPC.hold(at(height), HOVER)


def over_a_deck(noise=0.0):
    return Plant(AIRFRAME.body, MOTORS, noise * NOISE, suction, jnp.array(SUCTION))


@pytest.mark.slow
def test_the_vertical_loop_is_stable_against_suction():
    """From 5 cm above a hover at 2 cm over the deck, with delay and lag: no overshoot onto the deck, no offset."""
    record = flight(NMPC, hold(0.02), over_a_deck(), at(0.07), KEY)
    heights = np.asarray(record.state[:, 2])
    assert heights.min() > 0.01
    np.testing.assert_allclose(heights[-50:], 0.02, atol=5e-4)
    force = -SUCTION[0] * np.exp(-0.02 / SUCTION[1])
    np.testing.assert_allclose(record.disturbance[-1], [0.0, 0.0, force, 0.0, 0.0, 0.0], atol=0.02)
    assert set(jaxscp.status_names(record.status)) == {"converged"}


@pytest.mark.parametrize("fraction", [pytest.param(0.9, marks=pytest.mark.slow), 1.1])
def test_a_hover_has_no_offset_under_wind_and_another_mass(fraction):
    downwards = jnp.array([1.0, 1e9])  # N, a constant force
    plant = Plant(heavy(fraction), MOTORS, 0.0 * NOISE, suction, downwards)
    record = flight(NMPC, hold(1.0), plant, at(1.0), KEY)
    np.testing.assert_allclose(record.state[-1, :3], [0.0, 0.0, 1.0], atol=1e-3)


def test_a_start_against_suction_reaches_its_height():
    """From rest on the deck to 1 m, with noise."""
    record = flight(NMPC, hold(1.0), over_a_deck(noise=1.0), at(0.0), KEY)
    assert float(jnp.min(record.state[:, 2])) > -0.02
    np.testing.assert_allclose(record.state[-100:, :3].mean(0), [0.0, 0.0, 1.0], atol=5e-3)
    assert float(jnp.max(record.command)) <= 5.0


@pytest.mark.nightly
def test_the_closed_loop_over_the_deck_has_eigenvalues_inside_the_circle():
    """Of the whole loop's Jacobian at its fixed point: vehicle, motors, delay, controller's memory."""
    plant, reference = over_a_deck(), hold(0.02)
    still = closed_loop.begin(NMPC, reference, plant, at(0.02))

    @jax.jit
    def settle(loop):
        step = lambda loop, _: (closed_loop.tick(NMPC, reference, plant, loop, 0.0)[0], None)  # noqa: E731
        return jax.lax.scan(step, loop, None, length=2000)[0]

    floats, rest = eqx.partition(settle(still), eqx.is_inexact_array)
    flat, unravel = jax.flatten_util.ravel_pytree(floats)

    def advance(flat):
        loop = closed_loop.tick(NMPC, reference, plant, eqx.combine(unravel(flat), rest), 0.0)[0]
        return jax.flatten_util.ravel_pytree(eqx.filter(loop, eqx.is_inexact_array))[0]

    eigenvalues = np.linalg.eigvals(np.asarray(jax.jit(jax.jacfwd(advance))(flat)))
    # the quaternion's norm and the plan's time are neutral
    assert np.sort(np.abs(eigenvalues))[-3:].max() < 1.0 + 1e-6
    assert np.sum(np.abs(eigenvalues) > 0.9999) <= 2


@pytest.mark.slow
def test_the_program_of_a_tick_is_solved_as_by_osqp():
    for offset in (0.0, 0.5):
        qp, found = program_of(controller(14), hold(1.0), at(1.0).at[0].add(offset))
        np.testing.assert_allclose(found, solution_of_osqp(qp), atol=SAME_THRUST)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("plan", "calm", "rough"),
    [(adaptive_plan, 0.03, 0.1), (uniform_plan, 0.03, 0.1)],
)
def test_plans_are_flown_and_end_in_hover_at_the_goal(plan, calm, rough):
    """Bounds of the tracking error in m are about twice the measured errors."""
    solution = plan()
    assert jaxscp.status_names(solution.status) == "converged"
    reference = NMPC.follow(solution.trajectory, 0.0, HOVER)
    for plant, bound, key in ((CALM, calm, None), (ROUGH, rough, KEY)):
        record = flight_along(NMPC, reference, plant, key)
        assert tracking_error(record, reference) < bound
        np.testing.assert_allclose(record.state[-1, :3], reference.state[-1, :3], atol=0.05)
        assert float(jnp.max(record.command)) <= 5.0
        assert float(jnp.min(record.command)) >= 0.3 - 1e-12
