"""The two guiding ellipsoids against slow references and known shapes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.corridor import box
from jaxscp.corridor.ellipsoids import around_segment, inside_polytope

around = jax.jit(around_segment)
inside = jax.jit(inside_polytope)


def shrink_until_empty(points, half):
    """As Liu et al. 2017 tell it: shrink to the innermost point, look again, until none is inside."""
    axes = np.full(3, half)
    roll = np.eye(3)

    def depth(q):
        return np.linalg.norm((q @ roll.T) / axes, axis=1)

    within = points[depth(points) < 1.0]
    while len(within):
        nearest = within[np.argmin(depth(within))]
        angle = np.arctan2(nearest[2], nearest[1])
        roll = np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]])
        x, y, _ = roll @ nearest
        axes[1] = axes[2] = abs(y) / np.sqrt(1.0 - (x / axes[0]) ** 2)
        within = within[depth(within) < 1.0 - 1e-12]
    axes[2] = half
    within = points[depth(points) < 1.0 - 1e-12]
    while len(within):
        x, y, z = roll @ within[np.argmin(depth(within))]
        axes[2] = abs(z) / np.sqrt(1.0 - (x / axes[0]) ** 2 - (y / axes[1]) ** 2)
        within = within[depth(within) < 1.0 - 1e-12]
    return roll.T @ np.diag(axes)


@pytest.mark.parametrize("seed", range(12))
def test_the_closed_form_is_where_shrinking_ends(seed):
    rng = np.random.default_rng(seed)
    half = rng.uniform(0.5, 4.0)
    points = rng.uniform(-1.5 * half, 1.5 * half, size=(400, 3))
    points = points[np.hypot(points[:, 1], points[:, 2]) > 0.2 * half * rng.uniform()]
    expected = shrink_until_empty(points, half)
    got = np.asarray(around(jnp.asarray(points.T), jnp.ones(len(points), bool), half).shape)
    # The sign of an axis is free, the ellipsoid it spans is not.
    np.testing.assert_allclose(got @ got.T, expected @ expected.T, rtol=1e-9, atol=1e-12)


def test_without_points_the_ellipsoid_is_the_ball_on_the_segment():
    shape = around(jnp.zeros((3, 4)), jnp.zeros(4, bool), 2.0).shape
    np.testing.assert_allclose(shape, 2.0 * np.eye(3))


def test_many_points_equally_near_do_not_flatten_the_ellipsoid():
    angle = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
    ring = np.stack([0 * angle, 0.5 * np.cos(angle), 0.5 * np.sin(angle)])
    shape = np.asarray(around(jnp.asarray(ring), jnp.ones(64, bool), 2.0).shape)
    np.testing.assert_allclose(np.linalg.norm(shape, axis=0), [2.0, 0.5, 0.5], rtol=1e-9)


def random_rotation(rng):
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return rotation


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_ellipsoid_in_a_skewed_box_is_the_skewed_ball(seed):
    rng = np.random.default_rng(seed)
    skew = random_rotation(rng) @ np.diag(rng.uniform(0.3, 3.0, 3)) @ random_rotation(rng)
    shift = rng.normal(size=3)
    cube = np.concatenate([np.eye(3), -np.eye(3)])
    normals = cube @ np.linalg.inv(skew)
    lengths = np.linalg.norm(normals, axis=1)
    offsets = (1.0 + normals @ shift) / lengths
    normals = normals / lengths[:, None]
    padded = jnp.asarray(np.concatenate([normals, np.zeros((5, 3))]))
    ellipsoid, volume = inside(padded, jnp.asarray(np.append(offsets, np.ones(5))), jnp.asarray(shift))
    shape = np.asarray(ellipsoid.shape)
    # The barrier stops 1e-3 of the logarithm of volume short of the largest.
    assert np.log(abs(np.linalg.det(skew))) - 2e-3 < float(volume) <= np.log(abs(np.linalg.det(skew)))
    np.testing.assert_allclose(shape @ shape.T, skew @ skew.T, rtol=0.02, atol=0.02)


@pytest.mark.parametrize("seed", range(6))
def test_the_inscribed_ellipsoid_is_inside_and_no_small_change_makes_it_much_larger(seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = rng.uniform(0.3, 3.0, 30)
    walls = box([-4, -4, -4], [4, 4, 4])
    normals = np.concatenate([normals, np.asarray(walls.normals)])
    offsets = np.concatenate([offsets, np.asarray(walls.offsets)])
    ellipsoid, volume = inside(jnp.asarray(normals), jnp.asarray(offsets), jnp.zeros(3))
    shape, centre = np.asarray(ellipsoid.shape), np.asarray(ellipsoid.centre)

    def fits(shape, centre):
        return np.min((offsets - normals @ centre) / np.linalg.norm(shape.T @ normals.T, axis=0))

    assert fits(shape, centre) >= 1.0
    for _ in range(300):
        other = shape @ (np.eye(3) + 0.05 * rng.normal(size=(3, 3)))
        moved = centre + 0.05 * rng.normal(size=3)
        scaled = np.log(abs(np.linalg.det(other))) + 3 * np.log(fits(other, moved))
        assert scaled <= float(volume) + 2e-3


def test_a_polytope_without_room_at_the_start_gives_no_ellipsoid_and_no_nan():
    slab = box([-1, -1, 0], [1, 1, 1])
    ellipsoid, volume = inside(slab.normals, slab.offsets, jnp.zeros(3))
    assert float(volume) == -np.inf
    assert np.isfinite(np.asarray(ellipsoid.shape)).all()
