"""Sparse surfaces are closed for a vehicle that would pass between their points; doors and dense maps are not."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxscp.corridor import PointCloud, build_corridor, synthetic_maps
from jaxscp.corridor.gaps import with_closed_gaps
from jaxscp.corridor.spacing import typical_spacing

from .conftest import hall_points

RADIUS = 0.25


def largest_hole(cloud):
    """Distance from the wall of the hall to the nearest point, at worst."""
    rng = np.random.default_rng(1)
    wall = np.column_stack([np.full(5000, 2.9), rng.uniform(-2.8, 1.4, 5000), rng.uniform(0.2, 2.8, 5000)])
    return KDTree(cloud.points).query(wall)[0].max()


def random_points(count):
    """Points anywhere on the surfaces of the hall."""
    every = hall_points(0.05)
    return every[np.random.default_rng(0).permutation(len(every))[:count]]


@pytest.mark.parametrize(
    "points",
    [
        *(hall_points(spacing) for spacing in (0.7, 0.6, 0.55, 0.45)),
        *(hall_points(0.2)[::step] for step in (4, 5, 7, 9, 11)),
        *(random_points(count) for count in (1000, 1500, 2500)),
    ],
    ids=lambda points: f"{len(points)} points",
)
def test_a_ball_does_not_pass_a_sparse_wall(points):
    cloud = PointCloud.of(points)
    assert largest_hole(cloud) > RADIUS
    closed, longest = with_closed_gaps(cloud, RADIUS)
    assert longest > 2 * RADIUS
    assert largest_hole(closed) < RADIUS


def test_rows_of_a_scanner_are_closed():
    y, z = np.meshgrid(np.arange(0, 6, 0.1), np.arange(0, 4, 0.8))
    rows = PointCloud.of(np.stack([0 * y.ravel(), y.ravel(), z.ravel()], axis=1))
    closed, longest = with_closed_gaps(rows, RADIUS)
    assert longest == pytest.approx(0.8, abs=0.1)
    middle = np.column_stack([np.zeros(50), np.linspace(0.5, 5.5, 50), np.full(50, 1.2)])
    assert KDTree(closed.points).query(middle)[0].max() < RADIUS


@pytest.mark.parametrize("spacing", [0.2, 0.4, 0.6, 0.8])
def test_the_true_gap_stays_open(spacing):
    closed, _ = with_closed_gaps(PointCloud.of(hall_points(spacing)), RADIUS)
    assert KDTree(closed.points).query([3.0, 2.3, 1.5])[0] > RADIUS + 0.1


@pytest.mark.parametrize("kind", synthetic_maps.KINDS)
def test_dense_maps_are_left_as_they_are(kind):
    cloud = synthetic_maps.KINDS[kind](0).cloud.thinned(0.1)
    closed, longest = with_closed_gaps(cloud, RADIUS)
    assert closed is cloud
    assert longest == 0.0


def test_points_anywhere_in_a_volume_are_no_surface():
    cloud = PointCloud.of(np.random.default_rng(0).uniform(0, 10, size=(2000, 3)))
    assert with_closed_gaps(cloud, RADIUS)[0] is cloud


def test_few_points_are_left_as_they_are():
    cloud = PointCloud.of([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert with_closed_gaps(cloud, RADIUS)[0] is cloud


def test_too_many_points_are_warned_of(monkeypatch):
    monkeypatch.setattr("jaxscp.corridor.gaps._MOST_SPARSE", 400)
    cloud = PointCloud.of(hall_points(0.7))
    with pytest.warns(UserWarning, match=r"leave holes of 1\.1 m.*cut it to the flight"):
        assert with_closed_gaps(cloud, RADIUS) == (cloud, 0.0)


@pytest.mark.parametrize("count", [400, 200_000])
def test_the_spacing_is_that_of_the_grid_copies_left_out(count):
    edge = int(np.sqrt(count))
    grid = 0.3 * np.stack(
        [*np.meshgrid(np.arange(edge), np.arange(edge)), np.zeros((edge, edge))], -1
    ).reshape(-1, 3)
    assert typical_spacing(np.concatenate([grid, grid])) == pytest.approx(0.3)


def test_an_end_in_a_closed_gap_is_told_why():
    """0.35 m from every point of the map, between four points of a wall."""
    wall = np.array([[3.0, y, z] for y in np.arange(-4, 4, 0.5) for z in np.arange(0, 4, 0.5)])
    start, goal = [3.0, 0.25, 1.75], [0.0, 0.0, 1.5]
    around = {"lower": [-1, -4, 0], "upper": [6, 4, 4]}
    told = pytest.raises(ValueError, match=r"start \(3, 0\.25, 1\.75\) is .*gaps of up to .*close_gaps=False")
    with pytest.warns(UserWarning, match=r"up to 0\.71 m apart.* wider ones as openings"), told:
        build_corridor(wall, start, goal, RADIUS, **around)
    left_open = build_corridor(wall, start, goal, RADIUS, clearance=0.05, close_gaps=False, **around)
    assert left_open.found
