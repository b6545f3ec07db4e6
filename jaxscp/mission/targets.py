"""The target that a phase gives the controller, and the controller's reference from it."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.control import Reference
from jaxscp.core.types import Flag, Scalar, Vector3
from jaxscp.mission.phases import Phase
from jaxscp.mission.rules import Rules
from jaxscp.simulation import Observation
from jaxscp.simulation.simulate import CONTROL
from jaxscp.simulation.vehicles import FEET_DEPTH

STEP, COUNT = 0.02, 56  # s and samples: a horizon of one second and its delay
_PASSED = 0.1  # m under the deck at which the target of a landing stops
_SEARCH_SPEED = 0.8  # of the speed of an approach
_GAIN = 8.0  # 1/s, of the target's last part of the way: it smooths the noise of the deck's estimate


class Target(eqx.Module):
    """A place that moves."""

    position: Vector3
    """m"""
    velocity: Vector3
    """m/s"""


def advance(
    rules: Rules,
    phase: Int[Array, ""],
    target: Target,
    observation: Observation,
    in_phase: Scalar,
    push: Vector3,
) -> Target:
    """The target of this period.

    It goes to the place of the phase at a limited speed, on top of the deck's own velocity where that is its frame.
    A phase that begins from a cruise or from the deck starts at the vehicle's own place; then ``in_phase``, the s since
    its begin, is zero. ``push`` is the acceleration by the wind, m/s^2, against which a landing aims.
    """
    own, deck = observation.state(), observation.deck
    here = _is(
        phase, Phase.on_deck, Phase.spool_up, Phase.cruise, Phase.touch_down, Phase.landed, Phase.level_off
    )
    stopped = (in_phase <= 0.0) & _is(phase, Phase.hover, Phase.safe_hover)
    position = jnp.where(here | stopped, own[:3], target.position)
    over_deck = _is(phase, Phase.climb, Phase.approach, Phase.land, Phase.go_around)
    carried = jnp.where(over_deck, deck.velocity, 0.0)
    position = position + carried * CONTROL
    change, speed = _change(rules, phase, position, observation)
    change = change - jnp.where(_is(phase, Phase.land), rules.level_drift * push, 0.0)
    change = change + _search(rules, phase, observation, in_phase)
    # across and along the vertical apart: a slow descent does not slow the correction of its place
    across, along = change.at[2].set(0.0), change.at[:2].set(0.0)
    relative = _limited(across, rules.approach_speed) + _limited(along, speed)
    return Target(position + relative * CONTROL, carried + relative)


def _search(rules: Rules, phase, observation: Observation, in_phase: Scalar) -> Vector3:
    """Offset in m on a spiral that sinks, while an approach does not see the deck."""
    blind = _is(phase, Phase.approach) & (observation.deck.unseen > rules.deck_lost)
    radius = rules.search_rate * in_phase
    # It turns at a constant rate until it is as fast as it may be, and then at that speed while its radius grows.
    until = _SEARCH_SPEED * rules.approach_speed / (rules.search_rate * rules.search_turn)
    turning = jnp.minimum(in_phase, until) + until * jnp.log(jnp.maximum(in_phase / until, 1.0))
    angle = rules.search_turn * turning
    sunk = jnp.minimum(rules.search_descent * in_phase, rules.search_depth)
    spiral = jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), -sunk])
    return jnp.where(blind, spiral, 0.0)


def _limited(change: Vector3, speed: Scalar) -> Vector3:
    """Velocity in m/s over a way in m, up to a speed."""
    return change * jnp.minimum(_GAIN, speed / jnp.sqrt(change @ change + 1e-12))


def _change(rules: Rules, phase, position: Vector3, observation: Observation) -> tuple[Vector3, Scalar]:
    """Way in m from the target to the place of the phase, and the greatest vertical speed in m/s."""
    deck = observation.deck.position
    up = jnp.array([0.0, 0.0, 1.0])
    level = deck + FEET_DEPTH * up
    landing = level - _PASSED * up
    landing = jnp.where(_inside_cone(rules, observation), landing, landing.at[2].set(position[2]))
    places = {
        Phase.climb: (level + rules.start_height * up, rules.climb_speed),
        Phase.approach: (level + rules.approach_height * up, rules.climb_speed),
        Phase.go_around: (level + rules.approach_height * up, rules.climb_speed),
        Phase.land: (landing, descent(rules, position[2] - level[2])),
    }
    place, speed = position, jnp.ones(())
    for code, (where, limit) in places.items():
        place, speed = (
            jnp.where(phase == int(code), where, place),
            jnp.where(phase == int(code), limit, speed),
        )
    return place - position, speed


def descent(rules: Rules, height: Scalar) -> Scalar:
    """Speed of the descent in m/s at a height in m."""
    return jnp.clip(rules.descent_gain * height, rules.slowest_descent, rules.fastest_descent)


def _inside_cone(rules: Rules, observation: Observation) -> Flag:
    off = observation.state()[:3] - observation.deck.position
    height = jnp.maximum(off[2] - FEET_DEPTH, 0.0)
    return jnp.sqrt(off[:2] @ off[:2] + 1e-12) < rules.cone_floor + rules.cone_slope * height


def reached(rules: Rules, phase, target: Target, observation: Observation) -> Flag:
    """Whether the vehicle is at its target and moves with it; in a landing, whether it is low."""
    own = observation.state()
    place = own[:3] - target.position
    speed = own[3:6] - target.velocity
    height = own[2] - observation.deck.position[2] - FEET_DEPTH
    near = jnp.where(_is(phase, Phase.approach), rules.place_error, 2.0 * rules.place_error)
    way = jnp.where(_is(phase, Phase.cruise), 0.0, 1.0) * jnp.sum(place**2)
    at_target = (way < near**2) & (jnp.sum(speed**2) < rules.speed_error**2)
    at_place = at_target & (_remaining(rules, phase, target, observation) < near)
    return jnp.where(_is(phase, Phase.land), height < rules.low_height, at_place)


def _remaining(rules: Rules, phase, target: Target, observation: Observation) -> Scalar:
    """Way in m that the target has still to go."""
    change, _ = _change(rules, phase, target.position, observation)
    return jnp.sqrt(change @ change + 1e-12)


def window(plan: Reference, still: Reference, target: Target, cruise: Flag, time: Scalar) -> Reference:
    """The reference of the next second: the plan in a cruise, else a level vehicle that moves with the target.

    Args:
        plan: of the cruise.
        still: a vehicle at rest, with the compensation of disturbances.
        target: of the other phases.
        cruise: which of both.
        time: s, now.
    """
    later = STEP * jnp.arange(float(COUNT))
    planned, thrusts = plan.at(time + later)
    level = jnp.zeros(13).at[6].set(1.0).at[:6].set(jnp.concatenate([target.position, target.velocity]))
    moving = level + later[:, None] * jnp.zeros(13).at[:3].set(target.velocity)
    hover = jnp.broadcast_to(still.control[0], thrusts.shape)
    index = jnp.clip((time + later - plan.start) / plan.step, 0, plan.state.shape[0] - 1).astype(int)
    compensation = jnp.where(cruise, plan.compensation[index], still.compensation[:1])
    state, control = jnp.where(cruise, planned, moving), jnp.where(cruise, thrusts, hover)
    return Reference(time, jnp.asarray(STEP), state, control, compensation)


def _is(phase: Int[Array, ""], *codes: Phase) -> Flag:
    return jnp.any(jnp.stack([phase == int(code) for code in codes]))
