"""Whole corridors on random maps: safe, connected, and plain about what failed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.corridor import (
    Corridor,
    CorridorStatus,
    EllipsoidDecomposition,
    InflationFIRI,
    NoRoute,
    PointCloud,
    Polytope,
    box,
    build_corridor,
    chain,
    pad,
    synthetic_maps,
)
from jaxscp.corridor.build import _distance
from jaxscp.corridor.cells import cells_along
from jaxscp.corridor.overlaps import deepest_ball, intersect
from jaxscp.corridor.route import legs
from jaxscp.corridor.shapes import needed_faces, vertices, volume

pytest.importorskip("skimage", reason="needs the extra clouds")

RADIUS = 0.25
METHODS = [EllipsoidDecomposition(), InflationFIRI()]


def cells(corridor: Corridor):
    return [Polytope(n, b) for n, b in zip(corridor.normals, corridor.offsets, strict=True)]


def check(result, cloud):
    """What every corridor that is called found must be."""
    assert result.found, result.message
    polytopes = cells(result.corridor)
    for polytope, seed in zip(polytopes, result.seeds, strict=True):
        assert cloud.inside(polytope, margin=-1e-9).sum() == 0
        assert float(jnp.min(polytope.offsets - seed @ polytope.normals.T)) >= -1e-9
    for before, after, joint, overlap in zip(
        polytopes, polytopes[1:], result.corridor.joints, result.overlaps, strict=False
    ):
        both = intersect(before, after)
        gap = jnp.min(
            jnp.where(jnp.any(both.normals != 0, axis=1), both.offsets - both.normals @ joint, jnp.inf)
        )
        assert float(gap) == pytest.approx(overlap, abs=1e-9)
        assert overlap >= 0.1 - 1e-9


@pytest.mark.parametrize("kind", synthetic_maps.KINDS)
@pytest.mark.parametrize(
    "seed",
    [pytest.param(seed, marks=pytest.mark.slow if seed < 2 else pytest.mark.nightly) for seed in range(4)],
)
def test_random_maps_give_safe_connected_corridors(kind, seed):
    place = synthetic_maps.KINDS[kind](seed)
    method = METHODS[seed % 2]
    result = build_corridor(
        place.cloud,
        place.start,
        place.goal,
        RADIUS,
        method=method,
        voxel=0.2,
        lower=place.lower,
        upper=place.upper,
    )
    if isinstance(result.route, NoRoute):
        assert result.corridor is None
        assert result.status == CorridorStatus.no_route
        assert "no way" in result.message
        return
    check(result, place.cloud)
    assert result.corridor is not None
    assert float(result.corridor.clearance(jnp.asarray(place.start))[0]) >= -1e-9
    assert float(result.corridor.clearance(jnp.asarray(place.goal))[-1]) >= -1e-9
    for polytope in cells(result.corridor):
        corners = vertices(polytope)
        assert np.all(corners >= place.lower - 1e-6)
        assert np.all(corners <= place.upper + 1e-6)


def test_the_distance_to_every_original_point_is_the_radius():
    from scipy.optimize import minimize

    place = synthetic_maps.pillars(5)
    result = build_corridor(
        place.cloud, place.start, place.goal, RADIUS, voxel=0.2, lower=place.lower, upper=place.upper
    )
    polytope = cells(result.corridor)[0]
    corners = vertices(polytope)
    nearest = place.cloud.points[
        np.argsort(np.linalg.norm(place.cloud.points - corners.mean(axis=0), axis=1))[:300:30]
    ]
    for point in nearest:
        fit = minimize(
            lambda x, p=point: np.sum((x - p) ** 2),
            corners.mean(axis=0),
            jac=lambda x, p=point: 2 * (x - p),
            constraints={
                "type": "ineq",
                "fun": lambda x: np.asarray(polytope.offsets) - np.asarray(polytope.normals) @ x,
                "jac": lambda x: -np.asarray(polytope.normals),
            },
            method="SLSQP",
        )
        assert np.sqrt(fit.fun) >= RADIUS - 1e-5


def test_an_empty_cloud_is_flown_in_boxes():
    with pytest.warns(UserWarning, match="holds no point, so that no obstacle is known"):
        result = build_corridor(np.zeros((0, 3)), [0, 0, 1], [3, 0, 1], RADIUS)
    assert result.found
    assert result.corridor is not None
    assert result.corridor.count == 1
    assert volume(cells(result.corridor)[0]) == pytest.approx(7 * 4 * 4)


def test_the_carriers_deck_is_cropped():
    deck = PointCloud.of(
        np.stack(
            [*np.meshgrid(np.arange(-1, 1, 0.1), np.arange(-1, 1, 0.1)), np.zeros((20, 20))], -1
        ).reshape(-1, 3)
    )
    region = box([-1.1, -1.1, -0.1], [1.1, 1.1, 0.1])
    with pytest.raises(ValueError, match="goal"):
        build_corridor(deck, [3, 0, 2], [0, 0, 0.1], RADIUS)
    assert build_corridor(deck, [3, 0, 2], [0, 0, 0.1], RADIUS, remove=[region]).found


def test_a_start_near_a_wall_is_called_narrow_rather_than_safe():
    y, z = np.meshgrid(np.arange(-6, 6, 0.1), np.arange(-6, 6, 0.1))
    plates = [np.stack([y.ravel(), np.full(y.size, side), z.ravel()], axis=1) for side in (-0.28, 0.28)]
    slot = PointCloud.of(np.concatenate(plates))
    slot = PointCloud(slot.points[slot.points[:, 0] < 0.5])
    result = build_corridor(slot, [0.4, 0, 0], [4, 0, 0], RADIUS, voxel=None)
    assert result.status == CorridorStatus.narrow
    assert "least overlap" in result.message


def test_corridors_of_one_shape_batch():
    made = []
    for seed in (0, 1):
        place = synthetic_maps.pillars(seed)
        result = build_corridor(
            place.cloud,
            place.start,
            place.goal,
            RADIUS,
            lower=place.lower,
            upper=place.upper,
            voxel=0.2,
            polytopes=12,
            faces=40,
        )
        made.append(result.corridor)
        assert result.corridor is not None
        assert result.corridor.count == 12
        np.testing.assert_allclose(result.corridor.joints[-1], place.goal)
        # Every polytope past the real ones holds the goal, so its joint is in both.
        assert float(result.corridor.clearance(jnp.asarray(place.goal))[-1]) >= -1e-9
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), *made)
    assert both.normals.shape == (2, 12, 40, 3)


def test_a_corridor_larger_than_the_padding_is_an_error():
    room = Corridor(jnp.zeros((3, 6, 3)), jnp.ones((3, 6)), jnp.zeros((2, 3)))
    with pytest.raises(ValueError, match="3 polytopes of 6 faces"):
        pad(room, [0, 0, 0], polytopes=2)


def test_redundant_polytopes_are_dropped():
    with pytest.warns(UserWarning, match="holds no point"):
        result = build_corridor(PointCloud.of([]), [0, 0, 1], [10, 0, 1], RADIUS, longest=1.0)
    assert result.corridor is not None
    assert result.corridor.count < 10
    assert np.all(result.overlaps >= 0.1)


def test_cells_that_run_out_of_planes_are_made_smaller_or_that_is_told():
    rng = np.random.default_rng(0)
    cloud = rng.uniform([-1, -3, -3], [5, 3, 3], size=(900, 3))
    cloud = PointCloud.of(cloud[np.hypot(cloud[:, 1], cloud[:, 2]) > 0.6])
    smaller = build_corridor(cloud, [0, 0, 0], [4, 0, 0], RADIUS, method=EllipsoidDecomposition(planes=8))
    check(smaller, cloud)
    hopeless = build_corridor(cloud, [0, 0, 0], [4, 0, 0], RADIUS, method=EllipsoidDecomposition(planes=2))
    assert hopeless.status == CorridorStatus.unresolved
    assert "more planes" in hopeless.message


def test_the_chain_on_the_device_makes_the_same_polytopes_as_the_host():
    place = synthetic_maps.pillars(2)
    rng = np.random.default_rng(0)
    cloud = PointCloud(place.cloud.points[np.sort(rng.choice(place.cloud.count, 900, replace=False))])
    route = np.array([[1.0, 1.0, 2.0], [4.0, 1.0, 2.0], [4.0, 5.0, 2.0]])
    method = EllipsoidDecomposition()
    host = cells_along(method, legs(route, 10.0), cloud, RADIUS)
    device = jax.jit(chain)(
        method, jnp.asarray(route), jnp.asarray(cloud.points), jnp.ones(900, bool), RADIUS
    )
    np.testing.assert_allclose(device.corridor.offsets, host.polytope.offsets, atol=1e-8)
    np.testing.assert_array_equal(device.left, host.left)


def test_faces_that_do_not_matter_are_found():
    room, larger = box([0, 0, 0], [1, 2, 3]), box([-1, -1, -1], [4, 4, 4])
    assert needed_faces(intersect(larger, room)).tolist() == [6, 7, 8, 9, 10, 11]
    assert float(deepest_ball(room).radius) == pytest.approx(0.5)


@pytest.mark.parametrize("bad", [[0, 0], [[0, 0, 0]], "0 0 1", ["a", 0, 0], [[0, 1], 2]])
@pytest.mark.parametrize("name", ["start", "goal", "lower", "upper"])
def test_places_must_be_three_coordinates(name, bad):
    places = {"start": [0, 0, 1], "goal": [1, 1, 1], name: bad}
    with pytest.raises(ValueError, match=f"^{name} must be three coordinates in metres"):
        build_corridor([[0.0, 0.0, 0.0]], radius=RADIUS, **places)


@pytest.mark.parametrize("bad", ["0.3", [0.3, 0.3]])
def test_distances_must_be_numbers(bad):
    """Asked of the check alone: annotations are checked at run time in tests, and would come first."""
    with pytest.raises(ValueError, match="radius must be one number in metres, got"):
        _distance("radius", bad)


def test_a_name_of_a_file_is_no_cloud():
    with pytest.raises(ValueError, match=r"shape \(points, 3\), got 'hall\.ply'; read_cloud reads a file"):
        build_corridor("hall.ply", [0, 0, 1], [1, 1, 1], RADIUS)
