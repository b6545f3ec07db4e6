"""Corridors by hand: joints that are found, margins, unit normals, and errors that number polytopes."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.corridor import Corridor, PointCloud, Polytope, box, connect, inside_corridor, obstacles_near

ROOMS = [([0, 0, 0], [4, 2, 3]), ([3, 0, 0], [9, 2, 3]), ([8, 0, 0], [9, 9, 3])]


def rooms():
    return [box(*corners) for corners in ROOMS]


def test_joints_are_centres_of_largest_balls_in_the_overlaps():
    """The overlaps are 1 m wide along x alone, so that a largest ball may lie anywhere along y and z."""
    corridor = connect(rooms())
    np.testing.assert_allclose(corridor.joints[:, 0], [3.5, 8.5], atol=1e-4)
    for k, joint in enumerate(corridor.joints):
        assert float(corridor.clearance(joint)[k : k + 2].min()) == pytest.approx(0.5, abs=1e-6)


def test_one_polytope_needs_no_joint():
    assert connect(rooms()[:1]).joints.shape == (0, 3)
    assert connect(rooms()[:1], joints=[]).joints.shape == (0, 3)


def test_a_margin_moves_every_face_inwards():
    plain, smaller = connect(rooms()), connect(rooms(), margin=0.25)
    np.testing.assert_allclose(smaller.offsets, plain.offsets - 0.25)
    mixed = connect(
        [Polytope(jnp.eye(3), jnp.ones(3)), box([0, 0, 0], [1, 1, 1])], joints=[[0.5] * 3], margin=0.1
    )
    np.testing.assert_allclose(mixed.offsets[0], [0.9, 0.9, 0.9, 1, 1, 1])


def test_polytopes_that_do_not_meet_are_numbered():
    with pytest.raises(ValueError, match=r"polytopes 1 and 2 do not overlap.*no joint 1.*1 m apart"):
        connect([*rooms()[:2], box([10, 0, 0], [12, 2, 3])])
    with pytest.raises(ValueError, match=r"polytopes 0 and 1 do not overlap once 0\.6 m of margin"):
        connect(rooms()[:2], margin=0.6)


def test_a_polytope_that_is_empty_is_numbered():
    with pytest.raises(
        ValueError, match=r"polytope 2 is empty once 1\.2 m.*radius of 0\.5 m; is margin in m"
    ):
        connect([box([0, 0, 0], [9, 9, 9]), box([0, 0, 0], [9, 9, 9]), box([8, 0, 0], [9, 9, 3])], margin=1.2)
    upside = Polytope(box([0, 0, 0], [1, 1, 1]).normals, -box([0, 0, 0], [1, 1, 1]).offsets)
    with pytest.raises(ValueError, match=r"polytope 1 is empty: .* -0\.5 m; are its corners swapped"):
        connect([rooms()[0], upside])


def test_swapped_corners_are_noticed():
    with pytest.raises(ValueError, match=r"lower y 2 m exceeds upper y 0 m; are they swapped"):
        box([0, 2, 0], [4, 0, 3])


def test_a_flat_box_is_refused():
    with pytest.raises(ValueError, match=r"box: no width along y: lower and upper are both 0 m"):
        box([0, 0, 0], [5, 0, 2.4])


def test_a_margin_in_another_unit_is_suspected():
    with pytest.raises(ValueError, match=r"once 35 m of margin .*radius of 1 m; is margin in metres"):
        connect(rooms(), margin=35.0)


@pytest.mark.parametrize("joints", [[], [[3.5, 1, 1]], [[3.5, 1, 1]] * 3])
def test_a_wrong_number_of_joints_is_told(joints):
    with pytest.raises(ValueError, match=f"3 polytopes need 2 joints.*got {len(joints)}"):
        connect(rooms(), joints)


def test_nothing_is_no_corridor():
    with pytest.raises(ValueError, match="at least one polytope"):
        connect([])
    with pytest.raises(ValueError, match=r"not negative, got -0\.1"):
        connect(rooms(), margin=-0.1)


@pytest.mark.parametrize("factor", [1e-4, 3.0])
def test_normals_become_unit_vectors(factor):
    room = box([0, 0, 0], [4, 2, 3])
    rows = np.array([1, 1, factor, 1, 1, 1])
    scaled = Polytope(room.normals * rows[:, None], room.offsets * rows)
    np.testing.assert_allclose(connect([scaled], []).offsets, connect([room], []).offsets)
    plain = connect([room], [])
    scaled_rows = Corridor(plain.normals * rows[None, :, None], plain.offsets * rows, plain.joints)
    np.testing.assert_allclose(scaled_rows.with_unit_normals().normals, plain.normals)
    gradient = jax.grad(
        lambda f: Corridor(f * plain.normals, plain.offsets, plain.joints).with_unit_normals().offsets.sum()
    )
    assert np.isfinite(float(gradient(2.0)))


def test_unit_normals_stay_as_they_are_bit_by_bit():
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    room = Polytope(jnp.asarray(np.concatenate([turned, -turned])), jnp.ones(6))
    assert np.array_equal(connect([room], []).normals[0], room.normals)
    assert np.array_equal(connect([room], []).with_unit_normals().offsets[0], room.offsets)


@pytest.mark.parametrize(
    ("polytopes", "margin", "words"),
    [
        (box([0, 0, 0], [1, 1, 1]), 0.0, "a list of polytopes is expected, got one polytope"),
        ([Polytope(jnp.zeros((0, 3)), jnp.zeros(0))], 0.0, "polytope 0 has no faces"),
        ([box([0, 0, 0], [1, 1, 1])], np.nan, "margin must be one number of metres"),
        (
            [box([0, 0, 0], [1, 1, 1]), box([1, 0, 0], [2, 1, 1])],
            0.0,
            "they only touch; are they in flight order",
        ),
        (
            [box([0, 0, 0], [1, 1, 1]), box([3, 0, 0], [4, 1, 1])],
            0.0,
            "they are 2 m apart; are they in flight order",
        ),
    ],
)
def test_what_cannot_be_chained_is_named(polytopes, margin, words):
    with pytest.raises(ValueError, match=words):
        inspect.unwrap(connect)(polytopes, margin=margin)


def test_polytopes_may_come_one_by_one():
    found = inspect.unwrap(connect)(room for room in rooms())
    np.testing.assert_array_equal(found.offsets, connect(rooms()).offsets)


@pytest.mark.parametrize("number", [np.inf, np.nan])
def test_a_box_is_finite(number):
    with pytest.raises(ValueError, match="corners must be finite"):
        box([number, 0.0, 0.0], [1.0, 1.0, 1.0])


def test_joints_are_found_under_jit():
    @jax.jit
    def first(width):
        return connect(
            [box([0.0, 0, 0], jnp.array([4.0, 2, 3])), box([3.0, 0, 0], jnp.stack([width, 2.0, 3.0]))]
        ).joints[0]

    np.testing.assert_allclose(first(9.0), [3.5, 1.0, 1.5], atol=1e-4)


def test_points_near_a_corridor_are_padded_and_those_inside_are_found():
    cloud = PointCloud.of([[1, 1, 1], [4, 2.2, 1], [4, 2.4, 1], [50, 0, 0], [8.5, 9.1, 0.1]])
    corridor = connect(rooms())
    assert inside_corridor(corridor, cloud).tolist() == [True, False, False, False, False]
    near = obstacles_near(corridor, cloud, 0.25, decks=[box([8, 8, 0], [9, 10, 1])], size=8)
    assert near.points.shape == (8, 3)
    np.testing.assert_allclose(near.points[:3], cloud.points[[0, 1, 4]])
    assert near.present.tolist() == [True] * 3 + [False] * 5
    assert near.deck.tolist() == [False, False, True] + [False] * 5
    with pytest.raises(ValueError, match="3 obstacle points are near the corridor, more than size=2"):
        obstacles_near(corridor, cloud, 0.25, size=2)


def test_points_in_a_polytope_without_bounds_are_found():
    half = connect([Polytope(jnp.array([[0.0, 0.0, 1.0]]), jnp.zeros(1))], [])
    assert inside_corridor(half, PointCloud.of([[0, 0, -1e3], [0, 0, 1]])).tolist() == [True, False]


def wedge(random, middle):
    """A box about a place, cut by a slant plane: two of its edges are sharp."""
    slant = random.normal(size=3) * [1.0, 0.1, 1.0]
    normals = np.concatenate([np.eye(3), -np.eye(3), slant[None] / np.linalg.norm(slant)])
    offsets = np.append(random.uniform(1.0, 2.0, 6), 0.2) + normals @ np.full(3, middle)
    return Polytope(jnp.asarray(normals), jnp.asarray(offsets))


@pytest.mark.parametrize("seed", range(5))
def test_every_point_within_the_margin_of_a_polytope_is_found(seed):
    random, margin = np.random.default_rng(seed), 0.4
    cells = [wedge(random, middle) for middle in (0.0, 0.5)]
    rows = (jnp.stack([c.normals for c in cells]), jnp.stack([c.offsets for c in cells]))
    corridor = Corridor(*rows, jnp.zeros((1, 3)))
    places = random.uniform(-3.0, 3.0, (3000, 3))
    inside = np.any([np.all(places @ c.normals.T <= c.offsets, axis=1) for c in cells], axis=0)
    ways = random.normal(size=places.shape)
    near = places + margin * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    assert np.count_nonzero(inside) > 20
    assert inside_corridor(corridor, PointCloud.of(near[inside]), margin).all()
