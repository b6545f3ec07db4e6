"""A light simulation of a controlled vehicle: rigid body, motors with lag and delay, force of the air, noise."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.control import NMPC, Actuators, NMPCState, Reference
from jaxscp.dynamics import Dynamics
from jaxscp.dynamics.rotations import normalised
from jaxscp.integration import tableaus

SUBSTEPS = 5
NOISE = jnp.repeat(jnp.array([0.003, 0.02, 0.002, 0.02]), jnp.array([3, 3, 4, 3]))
"""Standard deviations of an estimate: m, m/s, quaternion, rad/s."""


def calm(time, state, parameters):
    """No force."""
    return jnp.zeros(3)


def suction(time, state, parameters):
    """Force of a deck below, -F0 exp(-h / h0) along z; parameters (F0 in N, h0 in m), deck at z = 0."""
    return jnp.zeros(3).at[2].set(-parameters[0] * jnp.exp(-state[2] / parameters[1]))


def wind(time, state, parameters):
    """A force, with gusts of a fifth of it at 0.5 Hz and 1.3 Hz."""
    gust = 0.1 * (jnp.sin(2 * jnp.pi * 0.5 * time) + jnp.sin(2 * jnp.pi * 1.3 * time))
    return parameters * (1.0 + gust)


class Plant(eqx.Module):
    """The true vehicle."""

    dynamics: Dynamics
    motors: Actuators
    noise: jax.Array
    force: Callable[..., Any] = eqx.field(default=calm, static=True)
    parameters: Any = ()

    def advance(self, state, thrust, command, time, tick):
        """State and thrusts after a tick, under a command that acts now."""
        size = tick / SUBSTEPS

        def step(carry, number):
            state, thrust = carry
            begin = time + number * size
            after = self.motors.advance(thrust, command, size)

            def rate(fraction, x):
                found = self.dynamics(x, thrust + fraction * (after - thrust), begin + fraction * size)
                if x.shape[0] == 13:
                    push = self.force(begin + fraction * size, x, self.parameters)
                    found = found.at[3:6].add(push / self.dynamics.mass)
                return size * found

            state = tableaus.integrate(tableaus.CLASSICAL, rate, state, 1)[-1]
            if state.shape[0] == 13:
                state = state.at[6:10].set(normalised(state[6:10]))
            return (state, after), None

        return jax.lax.scan(step, (state, thrust), jnp.arange(SUBSTEPS, dtype=float))[0]


class Loop(NamedTuple):
    """State of the closed loop between two ticks."""

    state: jax.Array
    thrust: jax.Array
    commands: jax.Array
    controller: NMPCState


class Record(NamedTuple):
    """What happened, tick by tick."""

    time: jax.Array
    state: jax.Array
    thrust: jax.Array
    command: jax.Array
    disturbance: jax.Array
    status: Any


def begin(nmpc: NMPC, reference: Reference, plant: Plant, state, thrust=None) -> Loop:
    """The loop before its first tick."""
    controller = nmpc.init(reference, state, active=thrust)
    commands = jnp.tile(controller.active, (plant.motors.delay, 1))
    return Loop(jnp.asarray(state), controller.active, commands, controller)


def tick(nmpc: NMPC, reference: Reference, plant: Plant, loop: Loop, time, noise=0.0):
    """The loop a tick later, and the record of the tick."""
    estimate = loop.state + noise
    controller, command = nmpc(reference, loop.controller, estimate, time)
    commands = jnp.concatenate([loop.commands, command[None]])
    state, thrust = plant.advance(loop.state, loop.thrust, commands[0], time, nmpc.horizon.tick)
    record = Record(time, loop.state, loop.thrust, command, controller.disturbance, controller.status)
    return Loop(state, thrust, commands[1:], controller), record


def fly(nmpc: NMPC, reference: Reference, plant: Plant, loop: Loop, ticks: int, key=None) -> Record:
    """A flight of so many ticks, in one scan."""
    size = loop.state.shape[0]
    random = jnp.zeros((ticks, size)) if key is None else jax.random.normal(key, (ticks, size))

    def step(loop, at):
        number, noise = at
        return tick(nmpc, reference, plant, loop, number * nmpc.horizon.tick, noise * plant.noise)

    return jax.lax.scan(step, loop, (jnp.arange(ticks, dtype=float), random))[1]
