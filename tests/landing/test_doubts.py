"""Doubts about the vehicle's size in its corridor, each beside a corridor without doubt."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.aot.aot import with_arrays
from jaxscp.corridor import box, connect, obstacles_near, pad
from jaxscp.dynamics.airframes import paper_carrier, paper_mav
from jaxscp.landing.doubts import doubts

ENDS = jaxscp.at_rest([1.0, 0.0, 1.0]), jaxscp.at_rest([5.0, 0.0, 1.0])
LAMP = [[3.0, 0.1, 1.0]]


def hall(half=1.0, **parts):
    corridor = connect([box([0.0, -half, 0.0], [6.0, half, 2.0])])
    return jaxscp.scenarios.through(corridor, *ENDS, **parts)


def _sized(radius):
    return dataclasses.replace(paper_mav(), radius=jnp.array(radius))


def test_a_sound_corridor_leaves_no_doubt():
    near = obstacles_near(hall().corridor, [[3.0, 1.2, 1.0]], 0.3)
    for parts in ({}, {"obstacles": [[3.0, 1.0, 1.0], [3.0, 1.2, 1.0]]}, {"near_obstacles": near}):
        assert doubts(hall(**parts)) == ()
    for case in (jaxscp.scenarios.platform_to_platform, jaxscp.scenarios.ascent_to_platform):
        assert doubts(case()) == ()


def test_points_inside_the_corridor_are_warned_of():
    with pytest.warns(UserWarning, match=r"obstacles: 1 points .*\(3, 0\.1, 1\) m.*near_obstacles="):
        hall(obstacles=LAMP)
    near = obstacles_near(hall().corridor, LAMP, 0.3)
    with pytest.warns(UserWarning, match="near_obstacles: 1 points lie inside the corridor"):
        hall(near_obstacles=near)


def test_points_of_a_deck_lie_in_the_corridor():
    near = obstacles_near(hall().corridor, LAMP, 0.3, decks=[box([2.0, -1.0, 0.0], [4.0, 1.0, 2.0])])
    assert doubts(hall(near_obstacles=near)) == ()


def test_a_door_whose_margin_was_taken_is_not_too_narrow():
    """Of a gap of 1.2 m, a vehicle with a hull of 0.35 m keeps 0.5 m for its centre."""
    rooms = [box([0, 0, 0], [4, 4, 3]), box([3, 1.4, 0], [6, 2.6, 2]), box([5, 0, 0], [9, 4, 3])]
    ends = jaxscp.at_rest([1.0, 2.0, 1.0]), jaxscp.at_rest([8.0, 2.0, 1.0])
    through = jaxscp.scenarios.through
    corridor = pad(connect(rooms, margin=0.35), ends[1].position, polytopes=4)
    assert float(corridor.with_unit_normals().margin) == 0.35
    assert doubts(through(corridor, *ends, airframe=_sized(0.35))) == ()
    with pytest.warns(UserWarning, match="polytope 1 leaves the centre a ball of radius 0.25 m"):
        narrower = through(connect(rooms, margin=0.35), *ends, airframe=_sized(0.36))
    assert narrower.solver_inputs().corridor.margin is None  # plans with and without a margin share programs


def test_a_corridor_narrower_than_the_vehicle_is_warned_of():
    with pytest.warns(
        UserWarning, match=r"corridor: polytope 0 .* 0\.05 m.*airframe.radius, 0\.076 m.*margin=0\.076"
    ):
        narrow = hall(half=0.05)
    larger = dataclasses.replace(hall(half=0.4), airframe=paper_carrier())
    assert "airframe.radius, 0.534 m" in doubts(larger)[0]
    known = dataclasses.replace(narrow, near_obstacles=obstacles_near(narrow.corridor, np.empty((0, 3)), 0.3))
    assert doubts(known) == ()


def test_traced_missions_have_no_doubts():
    def cost(height):
        return jaxscp.scenarios.through(
            hall().corridor, *ENDS, jnp.array([[3.0, 0.1, height]])
        ).obstacles.sum()

    assert float(jax.jit(cost)(1.0)) == pytest.approx(4.1)


def test_obstacles_that_are_not_known_far_enough_are_refused():
    near = obstacles_near(hall().corridor, [[3.0, 1.2, 1.0]], 0.05)
    with pytest.raises(
        jaxscp.InvalidScenario, match=r"near_obstacles\.reach: .* 0\.05 m .*airframe\.radius, 0\.076"
    ):
        jaxscp.validate(hall(near_obstacles=near), nodes=30)
    for where, name in (
        (lambda s: s.airframe.radius, "airframe.radius"),
        (lambda s: s.near_obstacles.spread, "near_obstacles.spread"),
    ):
        negative = eqx.tree_at(where, hall(near_obstacles=near), jnp.array(-0.1))
        with pytest.raises(jaxscp.InvalidScenario, match=f"{name}: must not be negative"):
            jaxscp.validate(negative, nodes=30)
    wrong = eqx.tree_at(lambda o: o.present, near, near.present[:-1])
    with pytest.raises(jaxscp.InvalidScenario, match=r"near_obstacles\.present: expected shape \(64,\)"):
        jaxscp.validate(dataclasses.replace(hall(), near_obstacles=wrong), nodes=30)
    kind = eqx.tree_at(lambda o: o.deck, near, jnp.zeros(64))
    with pytest.raises(jaxscp.InvalidScenario, match=r"near_obstacles\.deck: expected bool, got float64"):
        jaxscp.validate(dataclasses.replace(hall(), near_obstacles=kind), nodes=30)


def test_numbers_of_numpy_are_taken_and_masks_stay_masks():
    near = obstacles_near(hall().corridor, [[3.0, 1.2, 1.0]], 0.3)
    given = with_arrays(jax.tree.map(np.asarray, hall(near_obstacles=near)))
    assert given.near_obstacles.present.dtype == bool
    jaxscp.validate(given, nodes=30)
