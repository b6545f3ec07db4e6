"""A crop frees the deck that an end stands on, and no space behind it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.corridor import PointCloud, box, build_corridor
from jaxscp.corridor.decks import split_decks
from jaxscp.corridor.search_space import nearest_on_segment

from .conftest import GOAL, START, depth_in_solid

pytest.importorskip("skimage", reason="needs the extra clouds")


def around(place, crop):
    return box(np.asarray(place) - crop, np.asarray(place) + crop)


def planned(points, start, goal, crop):
    regions = [around(start, crop), around(goal, crop)]
    result = build_corridor(PointCloud.of(points), start, goal, 0.25, remove=regions)
    assert result.found, result.message
    assert result.corridor is not None
    for place, k in ((start, 0), (goal, -1)):
        assert float(result.corridor.clearance(jnp.asarray(place, float))[k]) >= -1e-9
    assert least_distance(result) >= 0.25 - 1e-6
    return result


def least_distance(result):
    """From the legs to the obstacle points that a certificate counts there, less the cloud's spread."""
    near, last = result.near_obstacles, len(result.seeds) - 1
    found = []
    for leg, segment in enumerate(result.seeds):
        counts = np.asarray(near.present & ~(near.deck & (leg in (0, last))))
        points = np.asarray(near.points)[counts]
        nearest = nearest_on_segment(points, *segment)
        found.append(np.linalg.norm(points - nearest, axis=1).min(initial=np.inf))
    return min(found) - float(near.spread)


def lowest(corridor):
    from jaxscp.corridor import Polytope
    from jaxscp.corridor.shapes import vertices

    cells = zip(corridor.normals, corridor.offsets, strict=True)
    return min(vertices(Polytope(n, b))[:, 2].min() for n, b in cells)


def test_from_floor_to_floor_nothing_dives_below_it(hall):
    result = planned(hall, [0.0, -1.5, 0.1], [6.0, -1.5, 0.1], 0.5)
    assert depth_in_solid(result.corridor) < 0.0
    assert lowest(result.corridor) >= 0.099 - 1e-6


def test_a_wall_beside_the_start_stays_a_wall(hall):
    result = planned(hall, [2.4, -1.5, 1.5], [3.6, -1.5, 1.5], 0.6)
    assert depth_in_solid(result.corridor) < 0.0
    assert result.route.points[:, 1].max() > 1.6


def test_a_wall_that_the_start_clings_to_stays_a_wall(hall):
    result = planned(hall, [2.7, -1.5, 1.5], [6.0, -1.5, 1.5], 0.6)
    assert depth_in_solid(result.corridor) < 0.0


def test_one_deck_for_both_ends(hall):
    result = planned(hall, [0.0, -1.5, 0.1], [0.6, -1.5, 0.1], 0.7)
    assert lowest(result.corridor) >= 0.099 - 1e-6


def test_a_sound_start_frees_nothing(hall):
    cloud = PointCloud.of(hall)
    regions = [around(START, 0.6), around(GOAL, 0.6)]
    both, decks = split_decks(cloud, regions, (START, GOAL), 0.25, None)
    assert both.count == cloud.count
    assert decks == (None, None)


def test_a_region_without_an_end_is_removed(hall):
    door = box([2.8, -2.0, 0.5], [3.2, -1.0, 2.5])
    result = build_corridor(PointCloud.of(hall), START, GOAL, 0.25, remove=[door])
    assert result.route.points[:, 1].max() < 1.0


def test_points_of_the_vehicle_itself_do_not_hem_it_in(hall):
    start = np.array([0.0, -1.5, 0.1])
    ring = np.linspace(0, 2 * np.pi, 30)
    own = start + np.column_stack([0.1 * np.cos(ring), 0.1 * np.sin(ring), np.full(30, 0.05)])
    planned(np.concatenate([hall, own]), start, GOAL, 0.5)


def test_without_a_crop_the_message_names_it(hall):
    with pytest.raises(ValueError, match=r"inside the safety radius.*--crop 0\.5.*remove="):
        build_corridor(PointCloud.of(hall), [0.0, -1.5, 0.1], GOAL, 0.25)
