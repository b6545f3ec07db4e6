"""The state machine: each phase ends as it should, and aborts go before progress."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from jaxscp.mission import Phase, Rules
from jaxscp.mission.machine import Facts, next_phase

CALM = Facts(
    height=jnp.asarray(1.0),
    offset=jnp.asarray(0.0),
    in_phase=jnp.asarray(0.1),
    reached=jnp.asarray(0.0),
    off_plan=jnp.asarray(0.0),
    plan_over=jnp.asarray(False),
    unseen=jnp.asarray(0.0),
    wind=jnp.asarray(0.0),
    attempts=jnp.asarray(1),
    time=jnp.asarray(10.0),
)
step = jax.jit(lambda phase, facts: next_phase(Rules(), phase, facts))


def after(phase, **facts):
    changed = {name: jnp.asarray(value, getattr(CALM, name).dtype) for name, value in facts.items()}
    return Phase(int(step(jnp.asarray(int(phase)), dataclasses.replace(CALM, **changed))))


@pytest.mark.parametrize("phase", set(Phase) - {Phase.spool_up})
def test_nothing_changes_without_a_reason(phase):
    assert after(phase) == phase


@pytest.mark.parametrize(
    ("phase", "facts", "expected"),
    [
        (Phase.on_deck, {"in_phase": 0.6}, Phase.spool_up),
        (Phase.spool_up, {"height": 0.05}, Phase.climb),
        (Phase.spool_up, {"height": 0.0, "in_phase": 5.1}, Phase.on_deck),
        (Phase.climb, {"reached": 0.4}, Phase.hover),
        (Phase.cruise, {"reached": 0.4}, Phase.cruise),
        (Phase.cruise, {"reached": 0.4, "plan_over": True}, Phase.hover),
        (Phase.cruise, {"off_plan": 0.9}, Phase.hover),
        (Phase.cruise, {"height": 0.3, "offset": 0.5}, Phase.climb),
        (Phase.cruise, {"height": 0.3, "offset": 0.5, "unseen": 9.0}, Phase.cruise),
        (Phase.cruise, {"wind": 7.0}, Phase.safe_hover),
        (Phase.hover, {"time": 300.0}, Phase.safe_hover),
        (Phase.approach, {"reached": 0.4}, Phase.land),
        (Phase.approach, {"reached": 0.4, "unseen": 0.5}, Phase.approach),
        (Phase.approach, {"in_phase": 31.0, "unseen": 31.0}, Phase.safe_hover),
        (Phase.land, {"height": 0.005}, Phase.touch_down),
        (Phase.land, {"height": 0.02, "reached": 0.3}, Phase.touch_down),
        (Phase.land, {"height": 0.005, "unseen": 0.5}, Phase.go_around),
        (Phase.land, {"height": 0.1, "offset": 0.3}, Phase.go_around),
        (Phase.land, {"height": 0.06, "wind": 1.0}, Phase.level_off),
        (Phase.land, {"height": 0.06, "wind": 0.1}, Phase.land),
        (Phase.land, {"height": 0.06, "wind": 1.0, "offset": 0.3}, Phase.go_around),
        (Phase.level_off, {"height": 0.005}, Phase.touch_down),
        (Phase.level_off, {"height": 0.02, "in_phase": 0.7}, Phase.touch_down),
        (Phase.level_off, {"height": 0.2, "in_phase": 0.7}, Phase.go_around),
        (Phase.go_around, {"reached": 0.4}, Phase.approach),
        (Phase.go_around, {"reached": 0.4, "attempts": 3}, Phase.safe_hover),
        (Phase.touch_down, {"in_phase": 0.6}, Phase.landed),
        (Phase.landed, {"wind": 9.0, "time": 300.0}, Phase.landed),
    ],
)
def test_a_phase_ends(phase, facts, expected):
    assert after(phase, **facts) == expected


def test_a_batch_of_phases_is_one_program():
    phases = jnp.arange(len(Phase))
    assert jax.vmap(lambda p: step(p, CALM))(phases)[int(Phase.landed)] == int(Phase.landed)
