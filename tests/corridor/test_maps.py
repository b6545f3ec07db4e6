"""Maps: the same from the same seed, inside their limits, and clear where one starts and ends."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxscp.corridor import synthetic_maps


@pytest.mark.parametrize("kind", synthetic_maps.KINDS)
def test_a_map_keeps_its_promises(kind):
    place, again, other = (
        synthetic_maps.KINDS[kind](4),
        synthetic_maps.KINDS[kind](4),
        synthetic_maps.KINDS[kind](5),
    )
    np.testing.assert_array_equal(place.cloud.points, again.cloud.points)
    assert place.cloud.points.shape != other.cloud.points.shape or not np.allclose(
        place.cloud.points, other.cloud.points
    )
    assert np.all(place.cloud.points >= place.lower)
    assert np.all(place.cloud.points <= place.upper)
    assert KDTree(place.cloud.points).query([place.start, place.goal])[0].min() >= 0.45
    assert place.goal[0] - place.start[0] > 0.5 * (place.upper - place.lower)[0]


def test_perlin_noise_is_zero_on_its_lattice_and_smooth_between():
    rng = np.random.default_rng(0)
    lattice = np.stack(np.meshgrid(*[np.arange(3.0)] * 3, indexing="ij"), axis=-1)
    np.testing.assert_allclose(synthetic_maps._gradient_noise(rng, lattice), 0.0)
    line = np.zeros((400, 1, 1, 3))
    line[:, 0, 0] = np.linspace([0.1, 0.3, 0.2], [2.1, 1.3, 0.7], 400)
    assert np.abs(np.diff(synthetic_maps._gradient_noise(rng, line).ravel())).max() < 0.03


def test_every_office_room_can_be_reached():
    for seed in range(5):
        doors = synthetic_maps._doors(np.random.default_rng(seed), 3)
        reached, fresh = {(0, 0)}, [(0, 0)]
        while fresh:
            i, j = fresh.pop()
            ways = {
                (i + 1, j): (0, i + 1, j),
                (i - 1, j): (0, i, j),
                (i, j + 1): (1, j + 1, i),
                (i, j - 1): (1, j, i),
            }
            fresh += [room for room, door in ways.items() if door in doors and room not in reached]
            reached |= {room for room, door in ways.items() if door in doors}
        assert len(reached) == 9


def test_a_map_too_full_to_stand_in_says_so():
    with pytest.raises(ValueError, match="fewer obstacles"):
        synthetic_maps.pillars(0, count=400, clear=3.0)
