"""Allocation of intervals to the legs of a route."""

from itertools import pairwise

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp import Planner, scenarios, status_names
from jaxscp.corridor import pad
from jaxscp.corridor.polytopes import box, connect
from jaxscp.landing.allocation import allocate, in_last, route_positions
from jaxscp.landing.route import route_of


def hall(lengths):
    """A chain of boxes along x with given lengths and overlaps of 10 cm."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    boxes = [box([a - 0.1, 0.0, 0.0], [b + 0.1, 2.0, 2.0]) for a, b in pairwise(ends)]
    corridor = connect(boxes, joints=[[x, 1.0, 1.0] for x in ends[1:-1]])
    return corridor, jnp.array([0.0, 1.0, 1.0]), jnp.array([ends[-1], 1.0, 1.0])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.2, 20.0), min_size=1, max_size=6), st.integers(8, 40))
def test_every_polytope_has_intervals_in_order_and_the_last_enough_to_land(lengths, nodes):
    cells = np.asarray(allocate(route_of(*hall(lengths)), nodes))
    counts = np.bincount(cells, minlength=len(lengths))
    assert np.all(np.diff(cells) >= 0)
    assert counts.sum() == nodes - 1
    assert counts.min() >= 1
    assert counts[-1] >= min(in_last(nodes), nodes - len(lengths))


@settings(max_examples=8, deadline=None)
@given(st.lists(st.floats(0.2, 20.0), min_size=1, max_size=6), st.integers(8, 60), st.integers(1, 5))
@pytest.mark.slow
def test_padding_changes_no_allocation(lengths, nodes, more):
    corridor, start, goal = hall(lengths)
    expected = allocate(route_of(corridor, start, goal), nodes)
    longer = pad(corridor, goal, polytopes=corridor.count + more, faces=9)
    route = route_of(longer, start, goal)
    assert int(route.padding) == more
    np.testing.assert_array_equal(allocate(route, nodes), expected)


def test_a_goal_at_a_joint_is_no_padding():
    """The last polytope is another one, and the landing may need it."""
    corridor, start, _ = hall([2.0, 3.0])
    route = route_of(corridor, start, corridor.joints[-1])
    assert int(route.padding) == 0
    assert np.unique(allocate(route, 30)).tolist() == [0, 1]


def test_a_hover_in_a_padded_room_has_all_intervals():
    corridor, start, _ = hall([2.0])
    route = route_of(pad(corridor, start, polytopes=3), start, start)
    assert len(np.unique(allocate(route, 30))) == 1


def test_long_polytopes_have_more_intervals():
    counts = np.bincount(np.asarray(allocate(route_of(*hall([2.0, 8.0, 4.0])), 40)))
    assert counts[1] > counts[2] > counts[0]


@pytest.mark.parametrize("lengths", [[4.0, 1.0] * 4, [4.0, 0.5, 4.0, 0.5, 4.0, 4.0], [1.0] * 8])
def test_short_legs_and_the_one_before_the_last_have_half_the_intervals_of_others(lengths):
    """The turns at their ends need them: with one or two, narrow chains of boxes end in ``dynamics_unmet``."""
    before_last = np.bincount(np.asarray(allocate(route_of(*hall(lengths)), 45)))[:-1]
    assert 2 * before_last.min() >= before_last.max()


@pytest.mark.parametrize(
    ("lengths", "counts"),
    [
        ([3.13, 3.61, 3.22], [3, 2, 6]),
        ([2.0] * 5, [2, 2, 2, 1, 6]),
        ([2.0] * 6, [2, 2, 2, 2, 2, 6]),
        ([5.0] * 4, [4, 4, 4, 6]),
    ],
)
def test_of_few_intervals_earlier_legs_get_the_odd_ones(lengths, counts):
    """The first starts from rest: with fewer there, plans were integrated too coarsely to be certified."""
    found = allocate(route_of(*hall(lengths)), sum(counts) + 1)
    assert np.bincount(np.asarray(found)).tolist() == counts


@pytest.mark.slow
def test_few_nodes_plan_light_and_heavy_vehicles():
    plan = Planner.paper(12)
    scenario = scenarios.ascent_to_platform()
    for mass in (0.5, 0.73, 1.0, 1.144, 1.3):
        for weight in (0.0, 1.0, 20.0):
            changed = eqx.tree_at(
                lambda s: (s.airframe.body.mass, s.weights.time),
                scenario,
                (jnp.asarray(mass), jnp.asarray(weight)),
            )
            assert status_names(plan(changed).status) == "converged", (mass, weight)


def test_route_is_evenly_spaced_within_each_polytope():
    route = route_of(*hall([3.0, 6.0]))
    cells = allocate(route, 20)
    x = np.asarray(route_positions(route, cells))[:, 0]
    steps = np.diff(x)
    for cell in (0, 1):
        np.testing.assert_allclose(steps[np.asarray(cells) == cell], steps[np.asarray(cells) == cell][0])
    np.testing.assert_allclose(x[[0, -1]], [0.0, 9.0])


@pytest.mark.nightly
def test_a_few_nodes_are_enough_to_land():
    """The cone's nodes must not belong to polytopes that the cone does not reach."""
    solution = Planner(nodes=12)(scenarios.ascent_to_platform())
    assert status_names(solution.status) == "converged"
