"""A closed room is cut open for its picture; obstacles in the open stay."""

import numpy as np
import pytest

from jaxscp.plot.hidden import at_height_of, cut_open, hidden, toward_viewer

VIEWER = toward_viewer(38.0, -70.0)
ALONG = np.linspace(0.0, 1.0, 50)[:, None]
PATH = (1.0 - ALONG) * [1.0, 1.0, 1.0] + ALONG * [5.0, 3.0, 1.5]  # m


def grid(*axes):
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def room():
    """Floor, ceiling and four walls of 6 x 4 x 3 m, a point every 10 cm."""
    x, y, z = (np.arange(0.0, top + 0.01, 0.1) for top in (6.0, 4.0, 3.0))
    sides = [grid(x, y, [h]) for h in (0.0, 3.0)]
    sides += [grid([h], y, z) for h in (0.0, 6.0)] + [grid(x, [h], z) for h in (0.0, 4.0)]
    return np.concatenate(sides)


def test_a_room_is_cut_open():
    assert hidden(PATH, room(), VIEWER).all()
    shown = cut_open(room(), PATH, VIEWER)
    assert not hidden(PATH, shown, VIEWER).any()
    for far in ([3.0, 4.0, 1.5], [3.0, 3.0, 0.0], [0.0, 3.0, 0.5]):  # back wall, floor and far side stay
        assert np.min(np.linalg.norm(shown - far, axis=1)) < 0.1


def test_from_above_a_room_has_walls_and_no_floor():
    shown = at_height_of(PATH, room())
    inner = np.all((shown[:, :2] > 0.5) & (shown[:, :2] < [5.5, 3.5]), axis=1)
    assert not inner.any()
    assert np.ptp(shown[:, 0]) == pytest.approx(6.0)


def test_obstacles_in_the_open_stay():
    pillar = grid(np.arange(2.0, 2.4, 0.1), np.arange(0.2, 0.6, 0.1), np.arange(0.0, 3.0, 0.1))
    np.testing.assert_array_equal(cut_open(pillar, PATH, VIEWER), pillar)
    np.testing.assert_array_equal(at_height_of(PATH, pillar), pillar)
