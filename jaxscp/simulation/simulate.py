"""A closed loop as one scan: physics at 400 Hz, inertial unit at 200 Hz, odometry and controller at 100 Hz.

The deck sensor samples at 33 Hz, and the carrier's own odometry at 10 Hz. ``begin`` and ``advance`` cut a flight into
parts; ``simulate`` flies one part.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxscp.core.trees import tree_where
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.simulation import bodies
from jaxscp.simulation.deck_estimator import DeckEstimate, DeckFilter
from jaxscp.simulation.estimator import ErrorStateFilter, Estimate
from jaxscp.simulation.sensors import IMU, DeckSensor, DeckState, Odometry, OdometryState
from jaxscp.simulation.world import State, World, WorldState, carrier_state, deck_of, vehicle_state

TICK = 2 * bodies.TIME_STEP
"""s between inertial samples."""
CONTROL = 2 * TICK
"""s between commands."""
_SIGHT, _MESSAGE = 3, 10  # control periods between samples of the deck, and of the carrier's odometry


class Observation(eqx.Module):
    """All that a controller knows: estimates of the vehicle and of the deck, no truth."""

    vehicle: Estimate
    deck: DeckEstimate

    def state(self) -> Float[Array, "13"]:
        """Estimated state of the vehicle: position m, velocity m/s, attitude, body rate rad/s."""
        return self.vehicle.state()


Controller = Callable[[Any, Observation, Array], tuple[Any, Float[Array, "rotors"]]]
"""(controller's state, observation, time s) -> (state, thrust commands N). It sees no truth."""


class Sensors(eqx.Module):
    """Sensors of the vehicle, messages of the carrier, and the filters that join them."""

    imu: IMU = eqx.field(default_factory=IMU)
    odometry: Odometry = eqx.field(default_factory=Odometry)
    estimator: ErrorStateFilter = eqx.field(default_factory=ErrorStateFilter)
    deck: DeckSensor = eqx.field(default_factory=DeckSensor)
    carrier: Odometry = eqx.field(default_factory=lambda: Odometry(delay=1))
    """The carrier's own odometry: a sample late at 10 Hz."""
    deck_filter: DeckFilter = eqx.field(default_factory=DeckFilter)


class Flight(eqx.Module):
    """Histories at 200 Hz: true states, and the estimates that the controller saw."""

    vehicle: Float[Array, "*ticks 13"]
    carrier: Float[Array, "*ticks 13"]
    estimate: Float[Array, "*ticks 13"]
    deck: Float[Array, "*ticks 6"]
    """Estimated position m and velocity m/s of the deck's surface, in the frame of ``estimate``."""
    thrusts: Float[Array, "*ticks rotors"]
    """True thrusts, N."""


class Measured(eqx.Module):
    """State of the sensors."""

    bias: Float[Array, "6"]
    odometry: OdometryState
    deck: DeckState
    carrier: OdometryState


class Loop(eqx.Module):
    """A flight at a moment: carry of the scan."""

    world: WorldState
    sensors: Measured
    observation: Observation
    controller: Any
    command: Float[Array, "rotors"]
    key: PRNGKeyArray
    count: Int[Array, ""]
    """Control periods since the begin."""


def begin(
    world: World, sensors: Sensors, first: Any, key: PRNGKeyArray, height: Scalar | float = 0.0
) -> Loop:
    """A flight before its first step.

    Args:
        world: bodies, air, motors.
        sensors: sensors and filters.
        first: the controller's first state.
        key: seed of gusts and noise.
        height: start over the deck, m.
    """
    keys = jax.random.split(key, 4)
    start = world.init(keys[0], height)
    truth, carrier = vehicle_state(start), carrier_state(start)
    measured = Measured(
        sensors.imu.init(keys[1]),
        sensors.odometry.init(truth),
        sensors.deck.init(keys[2]),
        sensors.carrier.init(carrier),
    )
    deck = sensors.deck_filter.init(truth, start.deck.position)
    observation = Observation(sensors.estimator.init(truth), deck)
    return Loop(start, measured, observation, first, start.motors.thrusts, keys[3], jnp.zeros((), int))


def advance(
    world: World, sensors: Sensors, function: Controller, loop: Loop, periods: int
) -> tuple[Loop, Flight]:
    """The flight after periods of 10 ms, and their history."""
    loop, flight = jax.lax.scan(
        lambda loop, _: _period(world, sensors, function, loop), loop, None, length=periods
    )
    return loop, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), flight)


def simulate(
    world: World,
    sensors: Sensors,
    controller: tuple[Controller, Any],
    key: PRNGKeyArray,
    ticks: int,
    height: Scalar | float = 0.0,
) -> Flight:
    """A flight from the deck, or from a height in m over it. ``jax.vmap`` over keys or worlds gives a batch.

    Args:
        world: bodies, air, motors.
        sensors: sensors and filters.
        controller: the controller's function and its first state.
        key: seed of gusts and noise.
        ticks: length of the flight in steps of 5 ms, an even number.
        height: start over the deck, m.
    """
    function, first = controller
    return advance(world, sensors, function, begin(world, sensors, first, key, height), ticks // 2)[1]


def _period(world: World, sensors: Sensors, function: Controller, loop: Loop) -> tuple[Loop, Flight]:
    """Two inertial samples, then all other sensors and one command."""
    key = jax.random.fold_in(loop.key, loop.count)
    physics, sense = jax.random.split(key)

    def tick(moving: tuple[WorldState, Estimate], key: PRNGKeyArray):
        return _physics(world, sensors, loop, moving, key)

    # not the whole loop: copies of a controller's memory would take longer than the physics
    moving = loop.world, loop.observation.vehicle
    (state, estimate), flight = jax.lax.scan(tick, moving, jax.random.split(physics, 2))
    observation = Observation(estimate, loop.observation.deck)
    loop = Loop(state, loop.sensors, observation, loop.controller, loop.command, loop.key, loop.count)
    measured, observation = _sense(sensors, loop, sense)
    controller, command = function(loop.controller, observation, loop.world.time)
    return Loop(loop.world, measured, observation, controller, command, loop.key, loop.count + 1), flight


def _physics(
    world: World, sensors: Sensors, loop: Loop, moving: tuple[WorldState, Estimate], key: PRNGKeyArray
) -> tuple[tuple[WorldState, Estimate], Flight]:
    """Two steps of the world, one inertial sample of the mean acceleration, one prediction."""
    state, estimate = moving
    before = vehicle_state(state)
    air, noise = jax.random.split(key)
    state = jax.lax.scan(
        lambda s, k: (world.step(s, loop.command, k), None), state, jax.random.split(air, 2)
    )[0]
    truth = vehicle_state(state)
    force, rate = _inertial(before, truth, world.airframe.body.gravity)
    sample = sensors.imu.measure(noise, force, rate, loop.sensors.bias)
    estimate = sensors.estimator.predict(estimate, sample, TICK)
    deck = loop.observation.deck.mean.reshape(6)
    history = Flight(truth, carrier_state(state), estimate.state(), deck, state.motors.thrusts)
    return (state, estimate), history


def _inertial(before: State, after: State, gravity: Vector3) -> tuple[Vector3, Vector3]:
    """Mean specific force in m/s^2 and mean body rate in rad/s between two states, body axes."""
    force = rotation_matrix(before[6:10]).T @ ((after[3:6] - before[3:6]) / TICK - gravity)
    return force, 0.5 * (before[10:] + after[10:])


def _sense(sensors: Sensors, loop: Loop, key: PRNGKeyArray) -> tuple[Measured, Observation]:
    """One sample of odometry and one correction; the deck and the carrier's message where they are due."""
    own, seeing, sent = jax.random.split(key, 3)
    truth, carrier = vehicle_state(loop.world), carrier_state(loop.world)
    odometry, measured = sensors.odometry.measure(own, truth, loop.sensors.odometry)
    estimate = sensors.estimator.correct(loop.observation.vehicle, measured)
    deck = sensors.deck_filter.predict(loop.observation.deck, estimate.state(), CONTROL)
    place = deck_of(loop.world, jnp.zeros(())).position
    after, (relative, turn, seen) = sensors.deck.measure(
        seeing, truth, place, carrier[6:10], loop.sensors.deck
    )
    due = loop.count % _SIGHT == 0
    deck = sensors.deck_filter.see(deck, relative, turn, seen & due)
    sights = tree_where(due, after, loop.sensors.deck)
    after, message = sensors.carrier.measure(sent, carrier, loop.sensors.carrier)
    due = loop.count % _MESSAGE == 0
    deck = tree_where(due, sensors.deck_filter.hear(deck, message), deck)
    messages = tree_where(due, after, loop.sensors.carrier)
    return Measured(loop.sensors.bias, odometry, sights, messages), Observation(estimate, deck)
