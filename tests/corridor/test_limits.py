"""The box of the map bounds the corridor, and its lowest point is the floor, unless limits are stated."""

import numpy as np
import pytest

from jaxscp.corridor import NoRoute, PointCloud, Polytope, build_corridor
from jaxscp.corridor.limits import flyable
from jaxscp.corridor.shapes import vertices

from .conftest import GOAL, START

pytest.importorskip("skimage", reason="needs the extra clouds")
Y, Z = np.meshgrid(np.arange(-3, 3.01, 0.1), np.arange(0, 3.01, 0.1))
WALL = PointCloud.of(np.stack([0 * Y.ravel(), Y.ravel(), Z.ravel()], axis=1))


def test_nobody_flies_round_the_end_of_what_was_seen():
    result = build_corridor(WALL, [-2, 0, 1.5], [2, 0, 1.5], 0.25)
    assert isinstance(result.route, NoRoute)
    assert "a way outside needs lower= and upper=" in result.message
    around = build_corridor(WALL, [-2, 0, 1.5], [2, 0, 1.5], 0.25, lower=[-4, -6, 0.2], upper=[4, 6, 3])
    assert around.found


def test_no_polytope_reaches_out_of_the_map_or_near_its_floor(hall):
    open_above = PointCloud.of(hall[hall[:, 2] < 2.9])
    result = build_corridor(open_above, START, GOAL, 0.25)
    assert result.found
    corners = np.concatenate(
        [vertices(Polytope(*c)) for c in zip(result.corridor.normals, result.corridor.offsets, strict=True)]
    )
    assert np.all(corners >= np.array([-1, -3, 0.25]) - 1e-6)
    assert np.all(corners <= np.array([7, 3, 2.8]) + 1e-6)


def test_above_flat_ground_there_is_a_margin_and_below_it_none():
    ground = PointCloud.of(
        np.stack([*np.meshgrid(np.arange(0, 9.0), np.arange(0, 9.0)), np.zeros((9, 9))], -1).reshape(-1, 3)
    )
    box = flyable(ground, np.array([1.0, 1, 2]), np.array([8.0, 8, 2]), 0.25)
    np.testing.assert_allclose(box.lower, [0, 0, 0.25])
    np.testing.assert_allclose(box.upper, [8, 8, 4])


def test_a_stray_point_does_not_widen_the_search(hall):
    strayed = PointCloud.of(np.concatenate([hall, [[9000.0, 9000.0, 9000.0]]]))
    result, plain = (build_corridor(cloud, START, GOAL, 0.25) for cloud in (strayed, PointCloud.of(hall)))
    np.testing.assert_allclose(result.route.points, plain.route.points)
    np.testing.assert_allclose(result.corridor.offsets, plain.corridor.offsets)
