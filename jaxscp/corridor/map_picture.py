"""A map from above and from the side, with start, goal and the limits of the flight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.extent import Triple
from jaxscp.corridor.map_report import MapReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_POINTS = 40_000
_VIEWS = ((0, 1, "from above"), (0, 2, "from the side"))
_ENDS = (("start", "o", "tab:green"), ("goal", "s", "tab:red"))


def draw_map(
    cloud: PointCloud,
    report: MapReport,
    *,
    start: Triple | None = None,
    goal: Triple | None = None,
    radius: float | None = None,
) -> Figure:
    """Picture of a map from above and from the side, to scale, with the report beneath.

    Points are shaded by their third coordinate. Start and goal are drawn with the vehicle's radius.

    Args:
        cloud: the map.
        report: facts about it, from ``map_report``.
        start: (3,) metres.
        goal: (3,) metres.
        radius: radius of the vehicle, metres; the report's by default.

    Example:
        >>> import matplotlib; matplotlib.use("Agg")
        >>> from jaxscp.corridor.map_report import map_report
        >>> ground = PointCloud.of([[0.2 * x, 0.2 * y, 0.0] for x in range(50) for y in range(50)])
        >>> figure = draw_map(ground, map_report(ground), start=[1, 1, 1], goal=[8, 8, 1])
        >>> [axes.get_title() for axes in figure.axes]
        ['from above', 'from the side']
        >>> import matplotlib.pyplot as plt; plt.close(figure)
    """
    import matplotlib.pyplot as plt

    size = np.maximum(report.upper - report.lower, 1e-9)
    heights = [max(size[1] / size[0], 0.25), max(size[2] / size[0], 0.15)]
    tall = float(np.clip(7.0 * sum(heights) + 2.0, 5.0, 14.0))
    figure, views = plt.subplots(2, 1, figsize=(9, tall), height_ratios=heights, layout="constrained")
    shown = np.all((cloud.points >= report.lower) & (cloud.points <= report.upper), axis=1)
    points = cloud.points[shown]
    points = points[np.random.default_rng(0).permutation(len(points))[:_MOST_POINTS]]
    for axes, (across, up, title) in zip(views, _VIEWS, strict=True):
        _scatter(axes, points, across, up)
        axes.set(title=title, xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal")
        _frame(axes, report, across, up)
        for style, place in zip(_ENDS, (start, goal), strict=True):
            if place is not None:
                _end(axes, np.asarray(place, float)[[across, up]], style, radius or report.radius or 0.0)
    if start is not None or goal is not None:
        views[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    figure.supxlabel(str(report), x=0.02, ha="left", fontsize=8, family="monospace", wrap=True)
    return figure


def _scatter(axes: Axes, points: np.ndarray, across: int, up: int) -> None:
    """Points shaded by their depth, the nearest to the viewer last."""
    depth = points[:, 3 - across - up]
    order = np.argsort(depth)[:: -1 if up == 2 else 1]
    style = {"cmap": "Greys", "s": 2, "vmin": _pale(depth)}
    axes.scatter(points[order, across], points[order, up], c=depth[order], **style)


def _end(axes: Axes, place: np.ndarray, style: tuple[str, str, str], radius: float) -> None:
    """Start or goal, with the vehicle's radius about it."""
    from matplotlib.patches import Circle

    name, marker, colour = style
    axes.plot(*place, marker, color=colour, label=name, markersize=6)
    axes.add_patch(Circle((place[0], place[1]), radius, fill=False, color=colour))


def _pale(depth: np.ndarray) -> float | None:
    """Shade of the lowest points, so that they stay visible on white."""
    return None if len(depth) == 0 else float(depth.min() - 0.6 * max(np.ptp(depth), 1e-9))


def _frame(axes: Axes, report: MapReport, across: int, up: int) -> None:
    """Outline of the map's box, dashed."""
    low, high = report.lower, report.upper
    x, y = [low[across], high[across]], [low[up], high[up]]
    axes.plot(
        [x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], "--", color="tab:blue", linewidth=0.8
    )
