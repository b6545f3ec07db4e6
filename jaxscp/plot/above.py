"""The scene from above."""

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from jaxscp.core.picture_style import BLACK, BLUE, GATE, GOAL, GREY, LIMIT, START
from jaxscp.corridor.shapes import vertices
from jaxscp.landing.mission import Ellipsoids
from jaxscp.landing.scenario import LandingScenario
from jaxscp.plot.curves import Curves
from jaxscp.plot.hidden import at_height_of


def draw_above(ax: Axes, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes:
    """Corridor, obstacles, zones, gates and path on the x-y plane, to one scale, in metres."""
    if scenario.obstacles is not None:
        points = at_height_of(curves.state[:, :3], np.asarray(scenario.obstacles))
        ax.plot(*points[:, :2].T, ".", color=GREY, markersize=0.8, alpha=0.5, zorder=1)
    for cell in scenario.corridor.distinct():
        corners = vertices(cell)[:, :2]
        outline = corners[ConvexHull(corners).vertices]
        ax.add_patch(Polygon(outline, facecolor=BLUE, alpha=0.06, zorder=2))
        ax.add_patch(Polygon(outline, fill=False, edgecolor=BLUE, linewidth=0.7, alpha=0.6, zorder=2))
    _draw_shadows(ax, scenario.keep_out, LIMIT)
    _draw_shadows(ax, scenario.gates, GATE)
    ax.plot(*curves.state[:, :2].T, color=BLACK, linewidth=1.4, zorder=4)
    ax.plot(*nodes.state[:, :2].T, "o", color=BLACK, markersize=2.2, zorder=5)
    goal = scenario.goal_at(jnp.asarray(nodes.time[-1]))
    for state, marker, color, size in ((scenario.start, "s", START, 6), (goal, "*", GOAL, 11)):
        x, y = np.asarray(state.position)[:2]
        ax.plot(x, y, marker, color=color, markersize=size, markeredgecolor="white", zorder=6)
    ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    return ax


def _draw_shadows(ax: Axes, zones: Ellipsoids | None, color: str) -> None:
    """Outlines of ellipsoids, seen from above."""
    if zones is None:
        return
    around = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = np.stack([np.cos(around), np.sin(around)], axis=1)
    for centre, shape in zip(np.asarray(zones.centres), np.asarray(zones.shapes), strict=True):
        semi_axes = np.linalg.inv(shape)[:2]  # image of the ball; its shadow has the root of this product
        root = np.linalg.cholesky(semi_axes @ semi_axes.T)
        ax.add_patch(Polygon(centre[:2] + circle @ root.T, color=color, alpha=0.35, linewidth=0, zorder=3))
