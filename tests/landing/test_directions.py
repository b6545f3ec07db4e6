"""Normals and quaternions of any length: the same directions give the same problem, in metres."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.core.arrays import unit_lengths
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import initial_guess
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.warm_guess import warm_guess
from tests.support.rooms import put, room, with_faces_scaled

NODES = 8
LOW = room(upper=(11.0, 5.0, 1.6))
LONG = 1.0009  # length of a quaternion that the rules still accept
SCALED = {
    "ceiling": with_faces_scaled(LOW, [1.0, 1.0, 1e-4, 1.0, 1.0, 1.0]),
    "every face": with_faces_scaled(LOW, [3e-5, 2.0, 1e-9, 1e6, 0.5, 7.0]),
    "attitude of the start": put(LOW, lambda s: s.start.attitude, LONG * LOW.start.attitude),
    "attitude of the goal": put(LOW, lambda s: s.goal.attitude, LOW.goal.attitude / LONG),
}


ROUNDING = 1e-12
SOLVED = 1e-3  # a guess comes of a convex program, whose last bits depend on the processor


@jax.jit
def lowered(scenario):
    """Parameters of the problem, the guess, and the guess of a re-plan."""
    allocation = allocate(scenario.route(), NODES)
    guess = initial_guess(scenario, allocation)
    path = jaxscp.Trajectory(jnp.linspace(0.0, 1.0, NODES), guess.states, guess.controls, guess.dilation)
    return landing_problem(scenario, allocation).arrays(), guess, warm_guess(scenario, path)


@pytest.mark.parametrize("name", SCALED)
def test_the_same_directions_give_the_same_problem_and_guess(name):
    jaxscp.validate(SCALED[name], NODES)
    found, expected = lowered(SCALED[name]), lowered(LOW)
    for a, b, tolerance in zip(found, expected, (ROUNDING, SOLVED, SOLVED), strict=True):
        for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
            np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)


def test_unit_vectors_keep_their_bits():
    turned = room(yaw=0.3)
    for a, b in zip(jax.tree.leaves(turned), jax.tree.leaves(turned.with_unit_directions()), strict=True):
        assert np.array_equal(a, b)


def test_the_rules_measure_in_metres():
    outside = put(SCALED["every face"], lambda s: s.start.position, [0.0, 0.0, 1.8])
    with pytest.raises(jaxscp.InvalidScenario, match=r"start\.position: lies 0\.(2|19)\d* m outside"):
        jaxscp.validate(outside, NODES)
    assert not jax.jit(lambda s: s.valid())(outside)
    assert float(SCALED["every face"].corridor.clearance(jnp.array([0.0, 0.0, 1.0]))[0]) == pytest.approx(0.6)


def test_a_face_without_direction_is_refused():
    normals = LOW.corridor.normals.at[0, 2].set(0.0)
    with pytest.raises(
        jaxscp.InvalidScenario, match=r"corridor\.normals: face 2 of polytope 0 .* length zero"
    ):
        jaxscp.validate(put(LOW, lambda s: s.corridor.normals, normals), NODES)


def test_rows_that_pad_are_no_faces():
    padded = jaxscp.corridor.pad(LOW.corridor, LOW.goal.position, polytopes=2, faces=9)
    jaxscp.validate(eqx.tree_at(lambda s: s.corridor, LOW, padded), NODES)


@pytest.mark.parametrize("length", [1.0, 1.5])
def test_a_change_along_a_direction_changes_nothing(length):
    """In derivatives too, and where the values are not touched."""
    vector = length * jnp.array([0.6, 0.0, 0.8])
    unit = lambda v: v / unit_lengths(v)  # noqa: E731
    along, across = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.8, 0.0, -0.6])
    np.testing.assert_allclose(jax.jvp(unit, (vector,), (along,))[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(jax.jvp(unit, (vector,), (across,))[1], across / length, atol=1e-12)


def test_regions_and_their_margins_are_in_metres():
    region = jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    scaled = jaxscp.corridor.Polytope(1e-3 * region.normals, 1e-3 * region.offsets)
    cloud = jaxscp.corridor.PointCloud.of([[1.1, 0.5, 0.5], [1.3, 0.5, 0.5]])
    assert (
        cloud.inside(scaled, margin=0.2).tolist()
        == cloud.inside(region, margin=0.2).tolist()
        == [True, False]
    )
