"""The rest of a mission, whose start lies behind some of its polytopes and gates."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import jaxscp
from jaxscp.corridor import box, connect
from jaxscp.landing.allocation import allocate, fits, gate_nodes
from jaxscp.landing.passed import LEAST_TIME, present_leg, without_passed
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
REST = without_passed(put(WHOLE, lambda s: s.start.position, HERE), LEG)


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


def at(x, y=1.0):
    return put(WHOLE, lambda s: s.start.position, [x, y, 1.5])


def test_a_start_in_its_polytope_is_on_its_leg():
    assert [int(present_leg(at(3.5), leg)) for leg in range(5)] == list(range(5))
    assert [int(present_leg(at(7.5), leg)) for leg in range(2, 6)] == list(range(2, 6))


def test_a_start_that_left_its_polytope_for_the_next_one_is_on_the_next_leg():
    """No gate is left out: the leg after it lies in the same polytope."""
    assert int(present_leg(at(8.2), 4)) == 5  # polytope 1 ends at 8 m, and polytope 2 begins at 7 m
    assert int(present_leg(at(8.2), 3)) == 3
    assert int(present_leg(at(5.5, 2.02), 4)) == 4  # outside of a side wall
    validated, allocation = at(8.2).without_passed(jnp.array([4, 4, 5, 5]), jnp.array(0), jnp.array(2.0))
    assert allocation.tolist() == [5, 5, 5, 5]
    jaxscp.validate(validated, nodes=30)


def test_an_allocation_serves_again_for_the_same_rest_alone():
    rest, whole = allocate(REST.route(), 30), allocate(WHOLE.route(), 30)
    assert bool(fits(rest, rest))
    assert not bool(fits(whole, rest))
    assert not bool(fits(rest, whole))


def test_the_leg_may_be_traced():
    traced = jax.jit(without_passed)(put(WHOLE, lambda s: s.start.position, HERE), jnp.array(LEG))
    for a, b in zip(jax.tree.leaves(traced), jax.tree.leaves(REST), strict=True):
        np.testing.assert_array_equal(a, b)


def test_little_may_be_left_of_the_first_leg():
    """The vehicle leaves its polytope soon. No other leg may shrink so."""
    fresh = jnp.array([2] * 6 + [3] * 10 + [4] * 6)
    assert bool(fits(jnp.array([2] + [3] * 13 + [4] * 8), fresh))
    assert not bool(fits(jnp.array([2] * 12 + [3] * 2 + [4] * 8), fresh))


def test_the_rest_of_a_plan_may_be_quicker_than_the_least_time_of_the_whole():
    rest = without_passed(WHOLE, LEG, 0.3)
    np.testing.assert_allclose(float(rest.dilation_min), LEAST_TIME * 0.3)
    assert float(WHOLE.dilation_min) > float(rest.dilation_min)
    assert float(without_passed(WHOLE, LEG, 1e3).dilation_min) == float(WHOLE.dilation_min)


def test_a_start_outside_may_have_passed_joints():
    """Passed joints lie at the start, which a measurement may put behind a wall."""
    outside = put(WHOLE, lambda s: s.start.position, [5.5, 2.02, 1.5])
    jaxscp.validate(without_passed(outside.measured(), LEG), nodes=30)
