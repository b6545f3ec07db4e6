"""A closed loop as one scan: physics at 400 Hz, inertial unit at 200 Hz, odometry and controller at 100 Hz."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.simulation import bodies
from jaxscp.simulation.estimator import ErrorStateFilter, Estimate
from jaxscp.simulation.sensors import IMU, Odometry, OdometryState
from jaxscp.simulation.world import State, World, WorldState, carrier_state, vehicle_state

Controller = Callable[[Any, Estimate, Array], tuple[Any, Float[Array, "rotors"]]]
"""(controller's state, estimate, time s) -> (state, thrust commands N). It sees no truth."""

TICK = 2 * bodies.TIME_STEP
"""s between inertial samples."""


class Sensors(eqx.Module):
    """Sensors of the vehicle and the filter that joins them."""

    imu: IMU = eqx.field(default_factory=IMU)
    odometry: Odometry = eqx.field(default_factory=Odometry)
    estimator: ErrorStateFilter = eqx.field(default_factory=ErrorStateFilter)


class Flight(eqx.Module):
    """Histories at 200 Hz: true states, and the estimates that the controller saw."""

    vehicle: Float[Array, "ticks 13"]
    carrier: Float[Array, "ticks 13"]
    estimate: Float[Array, "ticks 13"]
    thrusts: Float[Array, "ticks rotors"]
    """True thrusts, N."""


class _Loop(eqx.Module):
    """Carry of the scan."""

    world: WorldState
    bias: Float[Array, "6"]
    odometry: OdometryState
    estimate: Estimate
    controller: Any
    command: Float[Array, "rotors"]


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
        sensors: sensors and filter.
        controller: the controller's function and its first state.
        key: seed of gusts and noise.
        ticks: length of the flight in steps of 5 ms, an even number.
        height: start over the deck, m.
    """
    function, first = controller
    keys = jax.random.split(key, 3)
    start = world.init(keys[0], height)
    truth = vehicle_state(start)
    loop = _Loop(
        start,
        sensors.imu.init(keys[1]),
        sensors.odometry.init(truth),
        sensors.estimator.init(truth),
        first,
        start.motors.thrusts,
    )

    def tick(loop: _Loop, inputs):
        number, key = inputs
        new = _physics(world, sensors, loop, key)
        sense = jax.random.fold_in(key, 2)
        new = jax.lax.cond(number % 2 == 1, lambda n: _control(sensors, function, n, sense), lambda n: n, new)
        record = (
            vehicle_state(new.world),
            carrier_state(new.world),
            new.estimate.state(),
            new.world.motors.thrusts,
        )
        return new, record

    inputs = (jnp.arange(ticks), jax.random.split(keys[2], ticks))
    return Flight(*jax.lax.scan(tick, loop, inputs)[1])


def _physics(world: World, sensors: Sensors, loop: _Loop, key: PRNGKeyArray) -> _Loop:
    """Two steps of the world, one inertial sample of the mean acceleration, one prediction."""
    before = vehicle_state(loop.world)
    keys = jax.random.split(jax.random.fold_in(key, 0), 2)
    state = jax.lax.scan(lambda s, k: (world.step(s, loop.command, k), None), loop.world, keys)[0]
    force, rate = _inertial(before, vehicle_state(state), world.airframe.body.gravity)
    sample = sensors.imu.measure(jax.random.fold_in(key, 1), force, rate, loop.bias)
    estimate = sensors.estimator.predict(loop.estimate, sample, TICK)
    return _Loop(state, loop.bias, loop.odometry, estimate, loop.controller, loop.command)


def _inertial(before: State, after: State, gravity: Vector3) -> tuple[Vector3, Vector3]:
    """Mean specific force in m/s^2 and mean body rate in rad/s between two states, body axes."""
    force = rotation_matrix(before[6:10]).T @ ((after[3:6] - before[3:6]) / TICK - gravity)
    return force, 0.5 * (before[10:] + after[10:])


def _control(sensors: Sensors, function: Controller, loop: _Loop, key: PRNGKeyArray) -> _Loop:
    """One sample of odometry, one correction, one command."""
    odometry, measured = sensors.odometry.measure(key, vehicle_state(loop.world), loop.odometry)
    estimate = sensors.estimator.correct(loop.estimate, measured)
    controller, command = function(loop.controller, estimate, loop.world.time)
    return _Loop(loop.world, loop.bias, odometry, estimate, controller, command)
