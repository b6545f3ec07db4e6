"""The controller on small dynamics: exactness, limits, failures, batches and gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.control import NMPC, Actuators, Horizon, Tracking
from jaxscp.control.prediction import Plan, advance, linearise, sensitivities
from tests.support import closed_loop
from tests.support.closed_loop import Plant

TICKS = 300
CART = jaxscp.DoubleIntegrator(1)
ACTUATORS = Actuators([-2.0], [2.0], rate=40.0, time_constant=0.05, delay=1)


def pendulum(x, u, t, length):
    """Angle from the upright position, and its rate, under an acceleration of the hinge."""
    return jnp.stack([x[1], (9.81 * jnp.sin(x[0]) + u[0] * jnp.cos(x[0])) / length])


PENDULUM = jaxscp.Dynamics.of(pendulum, states=2, controls=1, parameters=jnp.asarray(0.5))


def controller(weights=None, dynamics=CART, actuators=ACTUATORS):
    tracking = Tracking([10.0, 1.0], [10.0, 5.0], [0.01], [1e-4]) if weights is None else weights
    return NMPC(dynamics, actuators, tracking, horizon=Horizon(iterations=12, tolerance=1e-10))


@eqx.filter_jit
def flight(nmpc, start, ticks=TICKS):
    target = at_origin(nmpc)
    plant = Plant(nmpc.dynamics, nmpc.actuators, jnp.zeros(2))
    return closed_loop.fly(nmpc, target, plant, closed_loop.begin(nmpc, target, plant, start), ticks)


def two_ticks(nmpc, reference, estimate):
    """A tick from a metre away, and a tick with another reference and estimate."""
    away, target = jnp.array([1.0, 0.0]), at_origin(nmpc)
    first = nmpc(target, nmpc.init(target, away), away, 0.0)
    return first, nmpc(reference, first[0], estimate, 0.01)


def at_origin(nmpc):
    return nmpc.hold(jnp.zeros(2), jnp.zeros(1))


@pytest.mark.slow
def test_a_cart_comes_to_rest_within_its_limits():
    record = flight(controller(), jnp.array([1.0, 0.0]))
    assert set(jaxscp.status_names(record.status)) == {"converged"}
    np.testing.assert_allclose(record.state[-1], 0.0, atol=0.01)
    assert float(jnp.min(record.state[:, 0])) > -0.02  # no overshoot beyond two centimetres
    assert float(jnp.max(jnp.abs(record.command))) <= 2.0
    assert float(jnp.max(jnp.abs(jnp.diff(record.thrust, axis=0)))) <= 40.0 * 0.01 + 1e-9


@pytest.mark.slow
def test_a_pendulum_is_held_upright():
    """Dynamics from a plain function, unstable."""
    nmpc = controller(dynamics=PENDULUM, actuators=Actuators([-20.0], [20.0], time_constant=0.02, delay=1))
    record = flight(nmpc, jnp.array([0.3, 0.0]))
    np.testing.assert_allclose(record.state[-1], 0.0, atol=0.01)


@pytest.mark.slow
def test_the_linearisation_is_the_derivative_of_a_rollout():
    """Sensitivities of all nodes in all controls, against forward mode through the nonlinear integration."""
    grid = Horizon().grid[:5]
    random = np.random.default_rng(0)
    first = jnp.array([0.4, -0.3])
    controls = jnp.asarray(random.normal(size=(5, 1)))

    @jax.jit
    def rollout(later):
        u, states = jnp.concatenate([controls[:1], later]), [first]
        for k in range(4):
            states.append(advance(PENDULUM, jnp.zeros(2), states[-1], u[k : k + 2], grid[k : k + 2]))
        return jnp.stack(states)

    plan = Plan(jnp.zeros(()), rollout(controls[1:]), controls)
    linear = jax.jit(lambda plan: linearise(PENDULUM, jnp.zeros(2), plan, grid, 1))(plan)
    columns = sensitivities(linear)
    np.testing.assert_allclose(columns[..., 0], 0.0, atol=1e-12)
    expected = jax.jacfwd(rollout)(controls[1:])[1:, :, :, 0]
    np.testing.assert_allclose(columns[..., 1:], expected, atol=1e-12)


BROKEN = jnp.full(2, jnp.nan)


@pytest.mark.parametrize("which", ["estimate", "reference"])
@pytest.mark.slow
def test_what_is_not_finite_leaves_the_shifted_plan(which):
    nmpc, away = controller(), jnp.array([1.0, 0.0])
    target = at_origin(nmpc)
    reference = eqx.tree_at(lambda r: r.state, target, jnp.full((2, 2), jnp.nan))
    (first, _), (sound, expected) = two_ticks(nmpc, target, away)
    _, (after, command) = two_ticks(nmpc, *((target, BROKEN) if which == "estimate" else (reference, away)))
    assert jaxscp.status_names(first.status) == jaxscp.status_names(sound.status) == "converged"
    assert jaxscp.status_names(after.status) == "numerical_error"
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves((after, command)))
    # the last plan is still good: one tick changes its command little
    np.testing.assert_allclose(command, expected, atol=0.1)


@pytest.mark.slow
def test_a_time_that_is_no_number_is_the_next_tick():
    nmpc = controller()
    target, state = at_origin(nmpc), jnp.array([1.0, 0.0])
    memory = nmpc.init(target, state)
    begun, _ = nmpc(target, memory, state, 0.0)
    told, expected = nmpc(target, begun, state, float(nmpc.horizon.tick))
    guessed, command = nmpc(target, begun, state, jnp.nan)
    assert jaxscp.status_names(told.status) == "converged"
    assert jaxscp.status_names(guessed.status) == "numerical_error"
    np.testing.assert_allclose(command, expected, atol=1e-9)
    later, _ = nmpc(target, guessed, state, 2.0 * float(nmpc.horizon.tick))
    assert jaxscp.status_names(later.status) == "converged"


@pytest.mark.slow
def test_too_few_iterations_are_said_and_still_keep_the_limits():
    nmpc = eqx.tree_at(lambda n: n.horizon, controller(), Horizon(iterations=1))
    (first, command), _ = two_ticks(nmpc, at_origin(nmpc), jnp.zeros(2))
    assert jaxscp.status_names(first.status) == "iteration_limit"
    assert float(jnp.abs(command)[0]) <= 2.0


def test_wrong_sizes_name_the_field():
    with pytest.raises(jaxscp.InvalidProblem, match=r"actuators\.lower: expected 1 controls"):
        NMPC(CART, Actuators([0.0, 0.0], [1.0, 1.0]))
    with pytest.raises(jaxscp.InvalidProblem, match=r"tracking\.control: "):
        NMPC(CART, ACTUATORS, Tracking([1.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0]))
    with pytest.raises(ValueError, match="iterations"):
        Horizon(iterations=0)
    for tick in (0.0, -0.01, np.nan):
        with pytest.raises(ValueError, match="tick"):
            Horizon(tick=tick)
    for intervals in ([], [0.0, 0.1], [0.1, -0.1], [np.nan]):
        with pytest.raises(ValueError, match="intervals"):
            Horizon(intervals=np.array(intervals))
    with pytest.raises(ValueError, match="tolerance"):
        Horizon(tolerance=0.0)


@pytest.mark.slow
def test_a_batch_of_flights_equals_single_ones():
    starts = jnp.asarray(np.random.default_rng(1).uniform(-1.0, 1.0, (64, 2)))
    nmpc = controller()
    batch = eqx.filter_jit(eqx.filter_vmap(lambda start: flight(nmpc, start)))(starts)
    for number in (0, 17, 63):
        single = flight(nmpc, starts[number])
        np.testing.assert_allclose(batch.state[number], single.state, atol=1e-9)
        np.testing.assert_allclose(batch.command[number], single.command, atol=1e-7)


@pytest.mark.slow
def test_gradients_through_a_closed_loop_are_differences():
    """Of the sum of squared positions, in the weights: reverse mode through 20 ticks."""

    @jax.jit
    def cost(weights):
        tracking = Tracking(weights[:2], weights[2:], jnp.array([0.01]), jnp.array([1e-4]))
        return jnp.sum(flight(controller(tracking), jnp.array([1.0, 0.0]), 20).state[:, 0] ** 2)

    weights = jnp.array([10.0, 1.0, 10.0, 5.0])
    gradient = jax.jit(jax.grad(cost))(weights)
    step = 1e-4 * jnp.eye(4)
    differences = jnp.stack([(cost(weights + d) - cost(weights - d)) / 2e-4 for d in step])
    np.testing.assert_allclose(gradient, differences, rtol=1e-5, atol=1e-9)
