"""The map of recent scans: it forgets with the way, and drops single leaves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscp.mission.mapping import RecentMap, Scan, in_odometry_frame


def test_scans_are_forgotten_with_the_way_not_with_time():
    recent, wall = RecentMap(memory=10.0), np.array([[5.0, 0.0, 1.0], [5.0, 0.1, 1.0]])
    place = np.zeros(3)
    for _ in range(30):
        recent.add(wall, place)
    assert recent.cloud().count == 60
    recent.add(wall, np.array([9.0, 0.0, 0.0]))
    assert recent.cloud().count == 62
    recent.add(wall, np.array([15.0, 0.0, 0.0]))
    assert recent.cloud().count == 4


def test_all_scans_but_the_last_can_be_dropped():
    recent, wall = RecentMap(memory=10.0), np.array([[5.0, 0.0, 1.0]])
    for _ in range(3):
        recent.add(wall, np.zeros(3))
    recent.forget()
    assert recent.cloud().count == 1


def test_single_leaves_are_dropped_and_surfaces_stay():
    random = np.random.default_rng(0)
    direction = random.standard_normal((300, 3))
    leaves = direction / np.linalg.norm(direction, axis=1)[:, None] * random.uniform(2.0, 20.0, (300, 1))
    y, z = np.meshgrid(np.arange(-1.0, 1.0, 0.15), np.arange(-1.0, 1.0, 0.15))
    wall = np.stack([np.full(y.size, 6.0), y.ravel(), z.ravel()], axis=1)
    recent = RecentMap(memory=10.0, denoise=True)
    recent.add(np.concatenate([leaves, wall]), np.zeros(3))
    left = recent.latest().points
    on_wall = np.abs(left[:, 0] - 6.0) < 1e-9
    assert on_wall.sum() == len(wall)
    assert (~on_wall).sum() < 15


@pytest.mark.parametrize(("count", "blocks"), [(1, False), (5, True)], ids=["leaf", "trunk"])
def test_a_leaf_blocks_no_way_and_a_trunk_does(count, blocks):
    beside = np.array([[5.0, 0.1, 2.0]]) + 0.02 * np.arange(count)[:, None]
    scan = Scan(np.concatenate([beside, [[9.0, 9.0, 2.0]]]), np.zeros(3), denoise=True)
    way = np.linspace([0.0, 0.0, 2.0], [10.0, 0.0, 2.0], 100)
    assert scan.blocks(way, 0.3, 0.4) == blocks
    assert Scan(beside, np.zeros(3)).blocks(way, 0.3, 0.4)  # without denoising, all returns count
    assert not Scan(beside, np.zeros(3)).blocks(way, 0.3, 3.0)
    assert not scan.blocks(way[:0], 0.3, 0.4)


def test_points_turn_with_the_attitude():
    turn = Rotation.from_euler("xyz", [0.2, -0.3, 1.0])
    x, y, z, w = turn.as_quat()
    state = np.concatenate([[1.0, 2.0, 3.0], np.zeros(3), [w, x, y, z], np.zeros(3)])
    points = np.random.default_rng(1).standard_normal((5, 3))
    ranges = np.linalg.norm(points, axis=1)
    directions = points / ranges[:, None]
    ranges[2] = 0.0
    found = in_odometry_frame(ranges, directions, state)
    np.testing.assert_allclose(found, turn.apply(points[[0, 1, 3, 4]]) + state[:3], atol=1e-12)
