"""The rest of a mission, whose start lies behind some of its polytopes and gates."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import jaxscp
from jaxscp.corridor import box, connect, pad
from jaxscp.landing.allocation import allocate, gate_nodes
from jaxscp.landing.passed import LEAST_TIME, present_place, without_passed
from jaxscp.landing.places import GATE, ends_route, fits, gates_behind, leg_of, places_on, polytope_of
from tests.support.rooms import put

BOXES = [box([0, 0, 0], [4, 2, 3]), box([3, 0, 0], [8, 2, 3]), box([7, 0, 0], [12, 2, 3])]
GATES = jaxscp.ellipsoids([[2.0, 1.0, 1.5], [5.0, 1.2, 1.5], [6.0, 0.8, 1.5]], 0.1)
WHOLE = dataclasses.replace(
    jaxscp.scenarios.through(
        connect(BOXES), jaxscp.at_rest([1.0, 1.0, 1.5]), jaxscp.at_rest([11.0, 1.0, 1.0])
    ),
    gates=GATES,
)
HERE = np.array([5.5, 1.0, 1.5])  # between the second gate and the third: legs are 0-1 | 2-3-4 | 5
LEG = 3
PLACE = 1 + 2 * GATE  # of this leg: polytope 1, behind two gates
REST = without_passed(put(WHOLE, lambda s: s.start.position, HERE), PLACE)


def places(mission, nodes=30):
    route = mission.route()
    return places_on(route, allocate(route, nodes))


def test_places_are_polytopes_and_gates_in_the_order_of_the_legs():
    found, legs = places(WHOLE), allocate(WHOLE.route(), 30)
    assert sorted(set(zip(polytope_of(found).tolist(), gates_behind(found).tolist(), strict=True))) == [
        (0, 0), (0, 1), (1, 1), (1, 2), (1, 3), (2, 3)
    ]  # fmt: skip
    np.testing.assert_array_equal(leg_of(found), legs)
    assert bool(ends_route(found[-1], WHOLE.corridor, 3))


def test_the_start_lies_in_the_first_polytope_again():
    assert WHOLE.route().polytope[LEG] == 1
    assert jnp.min(REST.corridor.clearance(jnp.asarray(HERE))[:2]) > 0.0
    jaxscp.validate(REST, nodes=30)


def test_passed_legs_have_no_length_and_no_interval():
    route = REST.route()
    allocation = allocate(route, 30)
    lengths = np.asarray(route.lengths)
    first = int(allocation[0])
    np.testing.assert_array_equal(lengths[:first], 0.0)
    assert lengths[first] > 0.0
    assert np.unique(allocation).tolist() == list(range(first, lengths.size))
    ahead = np.linalg.norm(np.diff(np.asarray(route.points)[first:], axis=0), axis=1)
    np.testing.assert_allclose(ahead.sum(), lengths.sum())


def test_passed_gates_ask_for_nothing():
    assert gate_nodes(REST.route(), allocate(REST.route(), 30)).tolist()[:2] == [0, 0]
    far = np.array([100.0, -50.0, 20.0])
    for k in range(2):
        assert (
            np.linalg.norm(np.asarray(REST.gates.shapes[k]) @ (far - np.asarray(REST.gates.centres[k]))) < 2
        )
    np.testing.assert_array_equal(REST.gates.centres[2], GATES.centres[2])
    np.testing.assert_array_equal(REST.gates.shapes[2], GATES.shapes[2])


def test_a_mission_at_its_start_is_the_whole_one():
    same = without_passed(WHOLE, 0)
    for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(WHOLE), strict=True):
        np.testing.assert_array_equal(a, b)


def at(x, y=1.0, mission=WHOLE):
    return put(mission, lambda s: s.start.position, [x, y, 1.5])


PLAN = jnp.array([0, GATE, GATE + 1, 2 * GATE + 1, 3 * GATE + 1, 3 * GATE + 2])  # one interval a leg


def test_a_start_in_its_polytope_is_in_its_place():
    assert [int(present_place(at(3.5), PLAN, leg)) for leg in range(5)] == PLAN[:5].tolist()
    assert [int(present_place(at(7.5), PLAN, leg)) for leg in range(2, 6)] == PLAN[2:].tolist()


def test_a_start_in_the_next_polytope_or_the_one_before_is_there():
    """Between the same gates. One outside of a side wall stays."""
    assert int(present_place(at(8.2), PLAN, 4)) == 3 * GATE + 2
    assert int(present_place(at(8.2), PLAN, 3)) == 2 * GATE + 1
    assert int(present_place(at(2.5), PLAN, 2)) == GATE
    assert int(present_place(at(5.5, 2.02), PLAN, 4)) == 3 * GATE + 1
    rest, kept = at(8.2).without_passed(PLAN, jnp.array(4), jnp.array(2.0))
    assert kept.tolist() == [3 * GATE + 2] * 6
    jaxscp.validate(rest, nodes=30)


def test_a_gate_ahead_is_asked_for_though_the_order_of_joint_and_gate_changes():
    """The gate lies in both polytopes: at first the way leads over the joint first, later to the gate first."""
    rooms = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])], joints=[[4.2, 0.3, 1.0]])
    ends = jaxscp.at_rest([1.0, 0.3, 1.0]), jaxscp.at_rest([8.0, 0.3, 1.0])
    gated = jaxscp.scenarios.through(rooms, *ends, gates=jaxscp.ellipsoids([[4.8, 1.8, 1.0]], 0.1))
    plan = places(gated)
    here = put(gated, lambda s: s.start.position, [4.7, 1.5, 1.0])
    assert [int(gated.route().to_gate[0]), int(here.route().to_gate[0])] == [1, 0]
    rest, _ = here.without_passed(plan, jnp.argmax(plan == 1), jnp.array(2.0))
    np.testing.assert_array_equal(rest.gates.shapes, gated.gates.shapes)
    np.testing.assert_array_equal(rest.gates.centres, gated.gates.centres)


def test_a_padded_corridor_whose_goal_moved_has_its_passed_polytopes():
    """Its last legs lead to the old goal and back: they count as legs again."""
    plain = dataclasses.replace(WHOLE, gates=None)
    padded = dataclasses.replace(plain, corridor=pad(plain.corridor, plain.goal.position, polytopes=5))
    moved = put(padded, lambda s: s.goal.position, [11.0, 1.2, 1.0])
    for plan in (places(plain), places(padded), places(moved)):
        for asked in (padded, moved):
            rest, _ = at(8.2, mission=asked).without_passed(plan, jnp.argmax(plan == 2), jnp.array(2.0))
            np.testing.assert_array_equal(rest.corridor.joints[:2], [[8.2, 1.0, 1.5]] * 2)
            jaxscp.validate(rest, nodes=30)


def test_a_scenario_of_another_route_is_whole():
    """The plan knows three gates and three polytopes."""
    fewer = dataclasses.replace(WHOLE, gates=jaxscp.ellipsoids([[6.0, 0.8, 1.5]], 0.1))
    shorter = dataclasses.replace(WHOLE, corridor=connect(BOXES[1:]))
    for other in (fewer, shorter):
        rest, _ = at(5.5, mission=other).without_passed(PLAN, jnp.array(3), jnp.array(jnp.inf))
        for a, b in zip(jax.tree.leaves(rest), jax.tree.leaves(at(5.5, mission=other)), strict=True):
            np.testing.assert_array_equal(a, b)


def test_places_serve_again_for_the_same_rest_alone():
    rest, whole = places(REST), places(WHOLE)
    assert bool(fits(rest, rest))
    assert not bool(fits(whole, rest))
    assert not bool(fits(rest, whole))


def test_the_place_may_be_traced():
    traced = jax.jit(without_passed)(put(WHOLE, lambda s: s.start.position, HERE), jnp.array(PLACE))
    for a, b in zip(jax.tree.leaves(traced), jax.tree.leaves(REST), strict=True):
        np.testing.assert_array_equal(a, b)


def test_little_may_be_left_of_the_first_leg():
    """The vehicle leaves its polytope soon. No other leg may shrink so."""
    fresh = jnp.array([2] * 6 + [3] * 10 + [4] * 6)
    assert bool(fits(jnp.array([2] + [3] * 13 + [4] * 8), fresh))
    assert not bool(fits(jnp.array([2] * 12 + [3] * 2 + [4] * 8), fresh))


def test_the_rest_of_a_plan_may_be_quicker_than_the_least_time_of_the_whole():
    rest = without_passed(WHOLE, PLACE, 0.3)
    np.testing.assert_allclose(float(rest.dilation_min), LEAST_TIME * 0.3)
    assert float(WHOLE.dilation_min) > float(rest.dilation_min)
    assert float(without_passed(WHOLE, PLACE, 1e3).dilation_min) == float(WHOLE.dilation_min)


def test_a_start_outside_may_have_passed_joints():
    """Passed joints lie at the start, which a measurement may put behind a wall."""
    outside = put(WHOLE, lambda s: s.start.position, [5.5, 2.02, 1.5])
    jaxscp.validate(without_passed(outside.measured(), PLACE), nodes=30)
