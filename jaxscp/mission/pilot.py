"""The pilot: from an observation to thrusts, through all phases of a mission, as a pure function."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscp.control import NMPC, Actuators, NMPCState, Reference
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.airframes import Airframe
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.mission import machine, targets
from jaxscp.mission.machine import Facts
from jaxscp.mission.phases import Phase
from jaxscp.mission.rules import Rules
from jaxscp.mission.targets import Target
from jaxscp.simulation import Observation
from jaxscp.simulation.simulate import CONTROL
from jaxscp.simulation.vehicles import FEET_DEPTH

SAMPLES = 400  # of a plan: 20 ms for 8 s
DECK_GAINS = 150.0, 22.0  # 1/s^2, 1/s, of attitude and body rate, on the deck
LEVEL_GAINS = 300.0, 30.0  # the same, just above it
MOTOR_LEAD = 0.02  # s in which the motors then reach a thrust: their lag is 30 ms
SINK_GAIN = 4.0  # 1/s, of the error of a descent that levels off
RESERVE = 0.9  # of the greatest thrust: an empty battery gives less


class PilotState(eqx.Module):
    """Memory of the pilot."""

    phase: Int[Array, ""]
    since: Scalar
    """s, time at which the phase began."""
    reached: Scalar
    """s, time since which the target is reached."""
    attempts: Int[Array, ""]
    """Approaches that were begun."""
    target: Target
    plan: Reference
    plan_end: Scalar
    """s"""
    controller: NMPCState
    command: Float[Array, "rotors"]


class Pilot(eqx.Module):
    """Flies all phases with one predictive controller. In the spool-up, thrust rises and attitude is held level.

    Args:
        airframe: the vehicle as the pilot knows it.
        rules: heights, speeds and limits.
        nmpc: the controller, of ``Pilot.of``.
        still: reference of a level vehicle at rest, with the controller's compensation of disturbances.
    """

    airframe: Airframe
    rules: Rules
    nmpc: NMPC
    still: Reference

    @staticmethod
    def of(airframe: Airframe, rules: Rules | None = None) -> "Pilot":
        """A pilot with the default controller: motors of 30 ms after a delay of 10 ms."""
        motors = Actuators(
            airframe.thrust_min, RESERVE * airframe.thrust_max, rate=80.0, time_constant=0.03, delay=1
        )
        nmpc = NMPC(airframe.body, motors)
        level = jnp.zeros(13).at[6].set(1.0)
        still = nmpc.hold(level, airframe.body.hover_thrust())
        return Pilot(airframe, Rules() if rules is None else rules, nmpc, still)

    def init(self, state: Float[Array, "13"]) -> PilotState:
        """The memory on the deck, at a known state."""
        plan = _resampled(self.still)
        zero, none = jnp.zeros(()), jnp.zeros((), int)
        return PilotState(
            none + int(Phase.on_deck),
            zero,
            zero,
            none,
            Target(state[:3], jnp.zeros(3)),
            plan,
            zero,
            self.nmpc.init(self.still, state, 0.0, self.airframe.thrust_min),
            self.airframe.thrust_min,
        )

    def __call__(
        self, state: PilotState, observation: Observation, time: Array
    ) -> tuple[PilotState, Float[Array, "rotors"]]:
        """One period of 10 ms: facts, phase, target, controller."""
        facts = self._facts(state, observation, time)
        phase = machine.next_phase(self.rules, state.phase, facts)
        changed = phase != state.phase
        since = jnp.where(changed, time, state.since)
        push = self._push(state, facts)
        target = targets.advance(self.rules, phase, state.target, observation, time - since, push)
        reached = jnp.where(targets.reached(self.rules, phase, target, observation), state.reached, time)
        begun = changed & (phase == int(Phase.approach))
        attempts = jnp.where(begun, state.attempts + 1, state.attempts)
        controller, command = self._thrusts(state, phase, target, observation, time)
        new = PilotState(
            phase,
            since,
            jnp.where(changed, time, reached),
            attempts,
            target,
            state.plan,
            state.plan_end,
            controller,
            command,
        )
        return new, command

    def _facts(self, state: PilotState, observation: Observation, time: Array) -> Facts:
        """Inputs of the decisions."""
        own, deck = observation.state(), observation.deck
        planned, _ = state.plan.at(time)
        off = own[:3] - deck.position
        force = state.controller.disturbance[:2]
        return Facts(
            height=off[2] - FEET_DEPTH,
            offset=jnp.sqrt(off[:2] @ off[:2] + 1e-12),
            in_phase=time - state.since,
            reached=time - state.reached,
            off_plan=jnp.sqrt(jnp.sum((planned[:3] - own[:3]) ** 2) + 1e-12),
            plan_over=time >= state.plan_end,
            unseen=deck.unseen,
            wind=jnp.sqrt(force @ force + 1e-12),
            attempts=state.attempts,
            time=time,
        )

    def _push(self, state: PilotState, facts: Facts) -> Vector3:
        """Horizontal acceleration by the wind, m/s^2; zero where it is calm."""
        force = state.controller.disturbance[:3].at[2].set(0.0)
        return jnp.where(facts.wind > self.rules.calm, force / self.airframe.body.mass, 0.0)

    def _thrusts(
        self, state: PilotState, phase: Array, target: Target, observation: Observation, time: Array
    ) -> tuple[NMPCState, Float[Array, "rotors"]]:
        """The controller's thrusts in the air; on the deck the least thrust, or thrust that rises."""
        cruise = phase == int(Phase.cruise)
        reference = targets.window(state.plan, self.still, target, cruise, time)
        memory, command = self.nmpc(reference, state.controller, observation.state(), time)
        least = self.airframe.thrust_min
        rising = self._rising(state.command, observation.state())
        spooling = phase == int(Phase.spool_up)
        off = (phase == int(Phase.on_deck)) | (phase == int(Phase.touch_down)) | (phase == int(Phase.landed))
        open_loop = jnp.where(spooling, rising, least)
        command = jnp.where(spooling | off, open_loop, command)
        # contact is no disturbance of the flight: on the deck the controller's memory begins again
        fresh = self.nmpc.init(reference, observation.state(), time, open_loop)
        memory = tree_where(spooling | off, fresh, memory)
        levelling = phase == int(Phase.level_off)
        command = jnp.where(levelling, self._level(memory, observation), command)
        memory = eqx.tree_at(lambda m: m.commands, memory, memory.commands.at[-1].set(command))
        return memory, command

    def _rising(self, before: Float[Array, "rotors"], own: Float[Array, "13"]) -> Float[Array, "rotors"]:
        """Thrusts that rise together, with a torque that holds the vehicle level in wind."""
        collective = jnp.mean(before) + self.rules.spool_rate * CONTROL
        return self._upright(jnp.zeros(()), own, collective, DECK_GAINS)

    def _level(self, memory: NMPCState, observation: Observation) -> Float[Array, "rotors"]:
        """Thrusts that level the vehicle quickly while it sinks onto the deck."""
        own, body = observation.state(), self.airframe.body
        sinking = own[5] - observation.deck.velocity[2] + self.rules.level_descent
        lift = body.mass * (-body.gravity[2] - SINK_GAIN * sinking) - memory.disturbance[2]
        thrusts = self._upright(lift, own, 0.0, LEVEL_GAINS)
        return self.nmpc.actuators.command(memory.active, thrusts, MOTOR_LEAD)

    def _upright(
        self, lift: Scalar, own: Float[Array, "13"], collective: Scalar | float, gains: tuple[float, float]
    ) -> Float[Array, "rotors"]:
        """Thrusts of a lift in N, with a torque that turns the vehicle level, on top of as much for all rotors."""
        body = self.airframe.body
        up = rotation_matrix(own[6:10])[2]  # the world's vertical in body axes
        tilt = jnp.cross(up, jnp.array([0.0, 0.0, 1.0]))
        torque = -body.inertia @ (gains[0] * tilt + gains[1] * own[10:])
        force = jnp.zeros(3).at[2].set(lift)
        thrusts = collective + body.least_thrusts() @ jnp.concatenate([force, torque])
        return jnp.clip(thrusts, self.airframe.thrust_min, self.nmpc.actuators.upper)

    def with_plan(self, state: PilotState, plan: Reference, time: Scalar | float) -> PilotState:
        """The memory after a plan for the cruise arrives; a plan begins now, where its ``start`` says so."""
        end = plan.start + plan.step * (plan.state.shape[0] - 2)
        return _with_phase(_replaced(state, plan, end), Phase.cruise, time)

    def with_approach(self, state: PilotState, time: Scalar | float) -> PilotState:
        """The memory after the order to land."""
        new = _with_phase(state, Phase.approach, time)
        return eqx.tree_at(lambda s: s.attempts, new, new.attempts + 1)

    def with_stop(
        self, state: PilotState, place: Float[Array | np.ndarray, "3"], time: Scalar | float
    ) -> PilotState:
        """The memory after the order to stop at a place, m."""
        new = _with_phase(state, Phase.hover, time)
        return eqx.tree_at(lambda s: s.target, new, Target(jnp.asarray(place), jnp.zeros(3)))


def _with_phase(state: PilotState, phase: Phase, time: Any) -> PilotState:
    now = jnp.asarray(time, state.since.dtype)
    code = jnp.asarray(int(phase), state.phase.dtype)
    return eqx.tree_at(lambda s: (s.phase, s.since, s.reached), state, (code, now, now))


def _replaced(state: PilotState, plan: Reference, end: Scalar) -> PilotState:
    return eqx.tree_at(lambda s: (s.plan, s.plan_end), state, (plan, jnp.asarray(end)))


def _resampled(held: Reference) -> Reference:
    """A reference at rest with as many samples as a plan."""
    many = lambda x: jnp.broadcast_to(x[:1], (SAMPLES + 1, *x.shape[1:]))  # noqa: E731
    parts = many(held.state), many(held.control), many(held.compensation)
    return Reference(jnp.zeros(()), jnp.ones(()), *parts)
