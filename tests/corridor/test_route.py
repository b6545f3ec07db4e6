"""Routes: clear, short, and honest about there being none."""

import numpy as np
import pytest

from jaxscp.corridor import NoRoute, PointCloud, Route, find_route
from jaxscp.corridor.route import segment_distance

pytest.importorskip("skimage", reason="needs the extra clouds")

AXIS = np.arange(0.0, 6.01, 0.1)
LOWER, UPPER = np.array([-4.0, 0.0, 0.0]), np.array([4.0, 6.0, 3.0])
START, GOAL = np.array([-3.0, 3.0, 1.5]), np.array([3.0, 3.0, 1.5])


def wall(gap=None):
    """A wall across the hall at x = 0, with a slit of some width at y = 5 from floor to ceiling."""
    y, z = np.meshgrid(AXIS, AXIS[AXIS <= 3.0])
    points = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    return PointCloud.of(points if gap is None else points[np.abs(points[:, 1] - 5.0) > 0.5 * gap])


def route(cloud, radius=0.25, **options):
    return find_route(cloud, START, GOAL, radius, lower=LOWER, upper=UPPER, **options)


def test_free_space_is_crossed_straight():
    found = route(PointCloud.of([]))
    assert isinstance(found, Route)
    assert found.length == pytest.approx(6.0)


def test_the_way_through_a_slit_is_clear_and_short():
    found = route(wall(gap=1.2))
    assert isinstance(found, Route)
    exact = [
        segment_distance(wall(gap=1.2).points, a, b)
        for a, b in zip(found.points, found.points[1:], strict=False)
    ]
    assert min(exact) >= 0.35
    np.testing.assert_allclose(found.clearance, exact)
    # No way can be shorter than the taut string through the slit's near edge.
    taut = 2 * np.hypot(3.0, 5.0 - 0.6 + 0.35 - 3.0)
    assert taut - 0.1 <= found.length <= 1.06 * taut
    np.testing.assert_array_equal(found.points[[0, -1]], [START, GOAL])


def test_a_closed_wall_is_a_result_with_volumes():
    found = route(wall())
    assert isinstance(found, NoRoute)
    assert "start reaches" in found.reason
    assert "do not touch" in found.reason


def test_a_slit_that_only_lacks_clearance_says_so():
    found = route(wall(gap=0.6), cell=0.1)
    assert isinstance(found, NoRoute)
    assert "ask for less clearance" in found.reason
    assert isinstance(route(wall(gap=0.6), clearance=0.02), Route)


def test_a_slit_narrower_than_the_first_voxels_is_found_with_finer_ones():
    found = route(wall(gap=0.95))
    assert isinstance(found, Route)
    assert found.cell < 0.2


@pytest.mark.parametrize("name", ["start", "goal"])
def test_an_end_in_the_safety_radius_is_an_error_with_the_distance(name):
    near = (START if name == "start" else GOAL) + [0.0, 0.12, 0.0]
    with pytest.raises(ValueError, match=rf"{name} .*0\.120 m from the nearest obstacle point"):
        route(PointCloud.of(near[None]))


def test_an_end_outside_the_limits_is_an_error():
    with pytest.raises(ValueError, match="outside the limits"):
        find_route(PointCloud.of([]), START, np.array([9.0, 0, 0]), 0.25, lower=LOWER, upper=UPPER)


def test_an_end_that_is_not_finite_is_an_error():
    with pytest.raises(ValueError, match="finite"):
        find_route(PointCloud.of([]), START, np.array([np.nan, 0, 0]), 0.25)


def test_a_start_within_the_clearance_but_not_the_radius_has_a_way_out():
    floor = np.stack([np.repeat(AXIS - 3, 61), np.tile(AXIS, 61), np.zeros(61 * 61)], axis=1)
    start = np.array([-2.5, 3.0, 0.27])
    found = find_route(PointCloud.of(floor), start, np.array([2.5, 3.0, 1.5]), 0.25, lower=LOWER, upper=UPPER)
    assert isinstance(found, Route)
    assert found.clearance[0] >= 0.25
    assert all(found.clearance[1:] >= 0.35 - 1e-9)


def test_the_spread_of_a_thinned_cloud_is_kept_too():
    cloud = wall(gap=2.0)
    thinned = cloud.thinned(0.3)
    found = route(thinned)
    assert isinstance(found, Route)
    for a, b in zip(found.points, found.points[1:], strict=False):
        assert segment_distance(cloud.points, a, b) >= 0.35 - 1e-9


def test_a_way_under_a_lowered_ceiling_keeps_the_clearance_to_the_limits_too():
    # Polytopes end at the limits, so a way along them would leave overlaps without room.
    cloud = wall()
    low = PointCloud(cloud.points[cloud.points[:, 2] < 2.0])
    found = route(low)
    assert isinstance(found, Route)
    assert np.all(found.points <= UPPER - 0.1 + 1e-9)
    assert np.all(found.points >= LOWER + 0.1 - 1e-9)


def test_a_hemmed_in_start_is_told():
    sphere = np.random.default_rng(0).normal(size=(4000, 3))
    sphere = START + 0.3 * sphere / np.linalg.norm(sphere, axis=1)[:, None]
    found = route(PointCloud.of(sphere))
    assert isinstance(found, NoRoute)
    assert "start is hemmed in" in found.reason
