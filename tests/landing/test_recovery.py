"""Recovery: a limit that a start breaks is loosened by twice as much, in the first intervals alone."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor import box, connect
from jaxscp.landing.recovery import FARTHEST, INTERVALS, LIMIT_RECOVERY, RECOVERY, ROOM
from tests.support.rooms import put, room

NODES = 30
ROOMS = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])])
BASE = jaxscp.scenarios.through(
    ROOMS,
    jaxscp.at_rest([1.0, 1.0, 1.0]),
    jaxscp.at_rest([8.0, 1.0, 1.0]),
    limits=jaxscp.flight_limits(speed=2.0, tilt=0.5, body_rate=3.0),
    keep_out=jaxscp.ellipsoids([[3.0, 1.0, 1.0]], 0.5),
)


def parameters(scenario, name):
    """Of a constraint, by its name."""
    problem, _ = scenario.problem(NODES)
    (found,) = [c.parameters for c in problem.constraints if c.name == name]
    return found


def starting_at(position, **parts):
    scenario = put(BASE, lambda s: s.start.position, position)
    start = dataclasses.replace(scenario.start, **{k: jnp.asarray(v) for k, v in parts.items()})
    return dataclasses.replace(scenario, start=start)


def test_a_start_inside_changes_no_bit():
    """Also close to a wall, and ahead of a polytope that it does not lie in."""
    for position in ([1.0, 1.0, 1.0], [3.98, 1.9, 1.0], [0.0, 0.0, 0.0]):
        scenario = starting_at(position)
        assert not bool(scenario.starts_outside())
        cells = np.asarray(scenario.problem(NODES)[1])
        offsets = np.asarray(parameters(scenario, "corridor").offsets)
        np.testing.assert_array_equal(offsets[:-1], np.asarray(ROOMS.offsets)[cells])
        np.testing.assert_array_equal(parameters(scenario, "speed"), np.full(NODES, 2.0))
        shapes = np.asarray(parameters(scenario, "keep-out").shapes)
        np.testing.assert_array_equal(shapes, np.broadcast_to(2.0 * np.eye(3), shapes.shape))


def test_a_wall_moves_out_by_twice_what_the_start_breaks():
    scenario = starting_at([1.0, 2.02, 1.0])
    moved = np.asarray(parameters(scenario, "corridor").offsets) - np.asarray(
        parameters(BASE, "corridor").offsets
    )
    beyond = np.asarray(ROOMS.normals[0]) @ [1.0, 2.02, 1.0] - np.asarray(ROOMS.offsets[0])
    np.testing.assert_allclose(moved[0], ROOM * np.maximum(beyond, 0.0), atol=1e-12)
    np.testing.assert_allclose(moved[:, np.argmax(beyond)][:INTERVALS], [0.04, 0.03, 0.02, 0.01], atol=1e-12)
    assert not moved[INTERVALS:].any()
    assert bool(scenario.starts_outside())


def test_a_vehicle_that_flies_outwards_has_room_to_brake():
    still, moving = (
        parameters(starting_at([1.0, 2.02, 1.0], velocity=[0.0, v, 0.0]), "corridor").offsets[0]
        for v in (0.0, 0.2)
    )
    braking = float(jnp.max(moving - still))
    np.testing.assert_allclose(braking, 0.2**2 / (2.0 * 0.981), rtol=1e-9)


def test_a_limit_begins_beyond_the_starts_value():
    scenario = starting_at([1.0, 1.0, 1.0], velocity=[2.1, 0.0, 0.0])
    found = np.asarray(parameters(scenario, "speed"))
    np.testing.assert_allclose(found[: INTERVALS + 1], [2.2, 2.15, 2.1, 2.05, 2.0], atol=1e-12)
    assert (found[INTERVALS:] == 2.0).all()
    assert bool(scenario.starts_outside())


def test_a_zone_around_the_start_begins_smaller():
    scenario = starting_at([2.53, 1.0, 1.0])  # 3 cm inside of a ball of 50 cm
    shapes = np.asarray(parameters(scenario, "keep-out").shapes)[:, 0, 0, 0]
    np.testing.assert_allclose(1.0 / shapes[: INTERVALS + 1], [0.44, 0.455, 0.47, 0.485, 0.5], atol=1e-12)
    assert bool(scenario.starts_outside())


OUTSIDE = {
    "start.position: lies 0.02": {"position": [1.0, 2.02, 1.0]},
    "start.velocity": {"position": [1.0, 1.0, 1.0], "velocity": [2.1, 0.0, 0.0]},
    "inside a zone": {"position": [2.53, 1.0, 1.0]},
}


@pytest.mark.parametrize("words", OUTSIDE)
def test_a_plan_refuses_what_a_replan_allows(words):
    scenario = starting_at(**OUTSIDE[words])
    with pytest.raises(jaxscp.InvalidScenario, match=words):
        jaxscp.validate(scenario, NODES)
    assert not bool(scenario.valid())
    jaxscp.validate(scenario.measured(), NODES)
    assert bool(scenario.measured().valid())


@pytest.mark.parametrize(
    "parts",
    [
        {"position": [1.0, 2.0 + 1.1 * RECOVERY, 1.0]},
        {"position": [1.0, 1.0, 1.0], "velocity": [2.0 + 2.2 * LIMIT_RECOVERY, 0.0, 0.0]},
        {"position": [2.5 + 1.1 * RECOVERY, 1.0, 1.0]},
    ],
)
def test_a_replan_refuses_more(parts):
    with pytest.raises(jaxscp.InvalidScenario, match=r"start\."):
        jaxscp.validate(starting_at(**parts).measured(), NODES)


def test_a_negative_recovery_is_refused():
    with pytest.raises(jaxscp.InvalidScenario, match="recovery: must not be negative"):
        jaxscp.validate(dataclasses.replace(BASE, recovery=-0.1), NODES)


def test_free_components_of_a_start_need_no_recovery():
    scenario = dataclasses.replace(
        room(start=(-1.05, 0.0, 1.0)), start_fixed=jaxscp.fixed(position=0.0), recovery=RECOVERY
    )
    assert not bool(scenario.starts_outside())


@pytest.mark.parametrize("speed", [1.0, 3.0, 30.0])
def test_a_fast_start_opens_a_wall_no_further(speed):
    """A braking distance of metres would lead through what stands behind the wall."""
    scenario = starting_at([1.0, 2.001, 1.0], velocity=[0.0, speed, 0.0])
    moved = np.asarray(parameters(scenario, "corridor").offsets) - np.asarray(
        parameters(BASE, "corridor").offsets
    )
    assert moved.max() == pytest.approx(ROOM * 0.001 + FARTHEST, abs=1e-9)


def test_relief_has_derivatives():
    """Finite ones, at rest and level too, where norms are zero."""
    slope = jax.grad(lambda x: jnp.sum(parameters(starting_at(x), "corridor").offsets))
    assert np.isfinite(slope(jnp.array([1.0, 2.02, 1.0]))).all()
    speeds = jax.grad(
        lambda v: jnp.sum(parameters(starting_at(jnp.array([1.0, 1.0, 1.0]), velocity=v), "speed"))
    )
    np.testing.assert_array_equal(speeds(jnp.zeros(3)), np.zeros(3))
