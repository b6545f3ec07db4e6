"""The picture holds every given part, to scale."""

import matplotlib as mpl
import numpy as np
import pytest

from jaxscp.corridor import PointCloud, Route, box, connect, draw, pad
from jaxscp.corridor.shapes import polygons

mpl.use("Agg")


def test_a_picture_shows_cloud_polytopes_route_and_trajectory():
    import matplotlib.pyplot as plt

    corridor = connect([box([0, 0, 0], [4, 2, 3]), box([3, 0, 0], [9, 2, 3])], joints=[[3.5, 1, 1]])
    way = np.array([[1.0, 1, 1], [8.0, 1, 1]])
    axes = draw(
        pad(corridor, way[1], polytopes=5),
        cloud=PointCloud.of([[0, 3, 0], [9, 3, 5]]),
        route=Route(way, np.array([1.0]), 0.1),
        trajectory=way,
        ceiling=4.0,
    )
    # One collection for the cloud and one for each polytope, the padding's copies left out.
    assert len(axes.collections) == 3
    assert [line.get_label() for line in axes.lines] == ["route", "trajectory"]
    assert axes.get_zlim() == pytest.approx((0, 3))
    plt.close(axes.figure)


def test_faces_come_as_polygons_in_order():
    for face in polygons(box([0, 0, 0], [1, 2, 3])):
        edges = np.roll(face, -1, axis=0) - face
        turns = np.cross(edges, np.roll(edges, -1, axis=0))
        assert np.all(turns @ turns[0] > 0)
