"""One picture of cloud, route, polytopes and trajectory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.route import Route
from jaxscp.corridor.shapes import polygons

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

_MOST_POINTS = 8000


def draw(
    corridor: Corridor | None = None,
    *,
    cloud: PointCloud | None = None,
    route: Route | None = None,
    trajectory: Float[np.ndarray, "samples 3"] | None = None,
    axes: Axes3D | None = None,
    ceiling: float | None = None,
) -> Axes3D:
    """Draw a corridor and what belongs to it in one 3-D view.

    Points are grey, lighter with height, and thinned to some thousands; polytopes are tinted along the flight
    with thin edges; the route is dashed, the trajectory solid. Everything is to scale.

    Args:
        corridor: polytopes; repeated ones, as padding leaves them, are drawn once.
        cloud: obstacles.
        route: polyline the corridor was made about.
        trajectory: (samples, 3) positions, metres.
        axes: where to draw; a new figure by default.
        ceiling: leave out points higher than this, metres, to look into a room.

    Example:
        >>> import matplotlib; matplotlib.use("Agg")
        >>> import jaxscp
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 2.0, 3.0])
        >>> axes = draw(jaxscp.corridor.connect([room], joints=[]))
        >>> len(axes.collections)
        1
        >>> import matplotlib.pyplot as plt; plt.close(axes.figure)
    """
    import matplotlib.pyplot as plt

    if axes is None:
        axes = plt.figure(figsize=(9, 7), layout="constrained").add_subplot(projection="3d")
    drawn = []
    if cloud is not None and cloud.count:
        drawn.append(_draw_cloud(axes, cloud, ceiling))
    if corridor is not None:
        drawn.append(_draw_polytopes(axes, corridor))
    if route is not None:
        axes.plot(*route.points.T, color="black", linestyle="--", linewidth=1.0, marker=".", label="route")
        drawn.append(route.points)
    if trajectory is not None:
        axes.plot(*np.asarray(trajectory).T, color="crimson", linewidth=2.5, label="trajectory")
        drawn.append(np.asarray(trajectory))
    _to_scale(axes, np.concatenate(drawn) if drawn else np.zeros((1, 3)))
    if route is not None or trajectory is not None:
        axes.legend(loc="upper right")
    return axes


def _draw_cloud(axes: Axes3D, cloud: PointCloud, ceiling: float | None) -> np.ndarray:
    points = cloud.points if ceiling is None else cloud.points[cloud.points[:, 2] <= ceiling]
    chosen = np.random.default_rng(0).permutation(len(points))[:_MOST_POINTS]
    points = points[chosen]
    low, high = points[:, 2].min(), points[:, 2].max()
    axes.scatter(
        *points.T, c=points[:, 2], cmap="gray", vmin=low, vmax=2.0 * high - low + 0.1, s=3, alpha=0.5
    )
    return points


def _draw_polytopes(axes: Axes3D, corridor: Corridor) -> np.ndarray:
    import matplotlib as mpl
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    cells = corridor.distinct()
    tints = mpl.colormaps["viridis"](np.linspace(0.1, 0.9, len(cells)))
    corners = []
    for tint, cell in zip(tints, cells, strict=True):
        faces = polygons(cell)
        axes.add_collection3d(
            Poly3DCollection(faces, facecolors=(*tint[:3], 0.12), edgecolors=(*tint[:3], 0.7), linewidths=0.6)
        )
        corners += faces
    return np.concatenate(corners) if corners else np.zeros((0, 3))


def _to_scale(axes: Axes3D, points: np.ndarray) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.maximum(high - low, 0.1))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
