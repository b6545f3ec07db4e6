"""The picture of a map has two views to scale, the ends of the flight and the report."""

import matplotlib as mpl
import numpy as np

from jaxscp.corridor import PointCloud, draw_map, map_report

from .conftest import GOAL, START

mpl.use("Agg")


def test_the_picture_shows_the_map_from_above_and_from_the_side(hall):
    import matplotlib.pyplot as plt

    cloud = PointCloud.of(np.concatenate([hall, [[9000.0, 9000.0, 9000.0]]]))
    figure = draw_map(cloud, map_report(cloud, START, GOAL), start=START, goal=GOAL)
    above, side = figure.axes
    assert (above.get_title(), above.get_xlabel(), above.get_ylabel()) == ("from above", "x [m]", "y [m]")
    assert (side.get_title(), side.get_ylabel()) == ("from the side", "z [m]")
    assert above.get_xlim()[1] < 10.0
    assert [text.get_text() for text in above.get_legend().get_texts()] == ["start", "goal"]
    plt.close(figure)
