"""The route over joints and gates: the shortest of all orders, by trying each."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor.polytopes import box, connect
from jaxscp.landing.allocation import allocate, gate_nodes
from jaxscp.landing.route import route_of

ROUNDING = 1e-12
LONG, OVERLAP = 4.0, 1.0  # m, of the boxes


def zigzag(count):
    """Boxes that turn left and right, overlapping in cubes, and points at the middles of the first and the last."""
    middle, boxes = np.zeros(3), []
    for number in range(count):
        half = (
            np.array([LONG, OVERLAP, OVERLAP]) / 2
            if number % 2 == 0
            else np.array([OVERLAP, LONG, OVERLAP]) / 2
        )
        boxes.append(box(list(middle - half), list(middle + half)))
        middle = middle + (np.array([1.5, 1.5, 0.0]))
    last = middle - np.array([1.5, 1.5, 0.0])
    return connect(boxes), jnp.array([-1.5, 0.0, 0.0]), jnp.asarray(last)


def length_of(points):
    return float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def shortest(corridor, start, goal, gates):
    """Least length over every assignment of gates to polytopes in order, with each gate inside its polytope."""
    heights = np.einsum("kfc,gc->gkf", corridor.normals, gates) - np.asarray(corridor.offsets)
    inside = np.all(heights <= 1e-9, axis=-1)
    joints, best = np.asarray(corridor.joints), np.inf
    for at in itertools.combinations_with_replacement(range(corridor.count), len(gates)):
        if all(inside[g, p] for g, p in enumerate(at)):
            points = [np.asarray(start)]
            for polytope in range(corridor.count):
                points += [np.asarray(gates[g]) for g in range(len(gates)) if at[g] == polytope]
                points += [joints[polytope]] if polytope < len(joints) else []
            best = min(best, length_of(np.array([*points, goal])))
    return best


@pytest.mark.parametrize("seed", range(5))
def test_no_other_order_is_shorter(seed):
    corridor, start, goal = zigzag(4)
    random = np.random.default_rng(seed)
    polytopes = np.sort(random.integers(0, 4, 3))
    centres = np.array([[1.5 * p, 1.5 * p, 0.0] for p in polytopes])
    # Some of these lie in the overlap of two boxes.
    along = random.uniform(-1.8, 1.8, 3)[:, None] * np.eye(3)[polytopes % 2]
    gates = jnp.asarray(centres + along)
    expected = shortest(corridor, start, goal, np.asarray(gates))
    route = route_of(corridor, start, goal, gates)
    if np.isfinite(expected):  # else no order passes every gate inside
        np.testing.assert_allclose(float(jnp.sum(route.lengths)), expected, rtol=ROUNDING)
    np.testing.assert_array_equal(route.points[route.to_gate + 1], gates)
    assert np.all(np.diff(route.to_gate) > 0)


def test_gates_lie_on_the_nodes_that_are_theirs():
    corridor, start, goal = zigzag(3)
    gates = jnp.array([[1.0, 0.0, 0.0], [1.5, 2.0, 0.0], [3.5, 3.0, 0.0]])
    route = route_of(corridor, start, goal, gates)
    allocation = allocate(route, 30)
    nodes = np.asarray(gate_nodes(route, allocation))
    assert np.all(np.diff(nodes) > 0)
    # The node of a gate begins the leg after it.
    np.testing.assert_array_equal(np.asarray(allocation)[nodes], np.asarray(route.to_gate) + 1)


def test_too_few_nodes_for_the_legs_are_refused():
    scenario = jaxscp.scenarios.through(
        zigzag(3)[0],
        jaxscp.at_rest([-1.5, 0.0, 0.0]),
        jaxscp.at_rest([3.0, 3.0, 0.0]),
        gates=jaxscp.ellipsoids([[0.0, 0.0, 0.0]] * 8, 0.1),
    )
    with pytest.raises(
        jaxscp.InvalidScenario, match=r"the 8 gates and the joints of 3 polytopes .* at least 12"
    ):
        jaxscp.Planner(nodes=10)(scenario)
