"""The scene: corridor, obstacles, zones, gates, landing cone and path in three dimensions."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from jaxscp.core.picture_style import BLACK, BLUE, BODY_AXES, GATE, GOAL, GREY, LIMIT, START
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.shapes import polygons
from jaxscp.dynamics import rotations
from jaxscp.landing.mission import BodyState, Ellipsoids
from jaxscp.landing.scenario import LandingScenario
from jaxscp.plot.curves import Array, Curves
from jaxscp.plot.hidden import cut_open, hidden, toward_viewer

ELEVATION, AZIMUTH = 38.0, -70.0  # degrees


def draw_scene(
    ax: Axes3D, scenario: LandingScenario, curves: Curves, nodes: Curves, every: int | None = None
) -> Axes3D:
    """Corridor, obstacles, landing cone, path and attitude in three dimensions, to one scale.

    Parts of the path behind obstacle points are dotted; a room that hides most of it is cut open. ``every``: body axes
    are drawn at every n-th node.
    """
    ax.computed_zorder = False  # matplotlib knows no depth: ``hidden`` does
    ax.set_proj_type("ortho")
    low, high = _bounds(scenario, nodes)
    points = np.empty((0, 3)) if scenario.obstacles is None else np.asarray(scenario.obstacles)
    points = cut_open(_within(points, low, high), curves.state[:, :3], toward_viewer(ELEVATION, AZIMUTH))
    if scenario.obstacles is not None:
        draw_obstacles(ax, points, low, high)
    draw_corridor(ax, scenario.corridor)
    draw_ellipsoids(ax, scenario.keep_out, LIMIT, "keep-out zone")
    draw_ellipsoids(ax, scenario.gates, GATE, "gate")
    goal = scenario.goal_at(jnp.asarray(nodes.time[-1]))
    draw_landing_cone(ax, goal, float(scenario.cone_angle))
    draw_body_axes(ax, nodes, length=0.05 * float(np.max(high - low)), every=every)
    x, y, z = curves.state[:, :3].T
    ax.plot(x, y, np.full_like(z, low[2]), color=GREY, linewidth=1.2, zorder=1, label="shadow on the ground")
    _draw_path(ax, points, curves, nodes)
    _mark_ends(ax, scenario.start, goal)
    _to_scale(ax, low, high)
    return ax


def _draw_path(ax: Axes3D, points: Array, curves: Curves, nodes: Curves) -> None:
    """The path: solid where it is seen, dotted behind obstacles; nodes where they are seen."""
    viewer = toward_viewer(ELEVATION, AZIMUTH)
    behind = hidden(curves.state[:, :3], points, viewer)
    seen, dotted = (np.where(rows[:, None], curves.state[:, :3], np.nan) for rows in (~behind, behind))
    ax.plot(*seen.T, color=BLACK, linewidth=1.8, zorder=6, label="integrated path")
    if behind.any():
        ax.plot(*dotted.T, ":", color=BLACK, linewidth=1.0, alpha=0.6, zorder=6, label="behind obstacles")
    at = nodes.state[:, :3][~hidden(nodes.state[:, :3], points, viewer)]
    ax.plot(*at.T, "o", color=BLACK, markersize=3.2, zorder=7, label="nodes")


def _to_scale(ax: Axes3D, low: Array, high: Array) -> None:
    """One scale on all axes, ticks at round metres, seen from above and aside."""
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True, steps=[1, 2, 5, 10]))
    ax.view_init(elev=ELEVATION, azim=AZIMUTH)
    ax.set_box_aspect(high - low)
    zoom: Any = _zoom_to_fill(ax, low, high)  # a float, which matplotlib's annotation does not know
    ax.set_box_aspect(high - low, zoom=zoom)
    for artist in (*ax.lines, *ax.collections):  # the scene may reach past the square that axes clip to
        artist.set_clip_on(False)


def _zoom_to_fill(ax: Axes3D, low: Array, high: Array, fraction: float = 0.84) -> float:
    """Zoom at which the box fills a fraction of the axes' rectangle; the rest is for ticks and labels."""
    xs, ys, zs = np.array(list(itertools.product(*zip(low, high, strict=True)))).T
    x, y, _ = proj3d.proj_transform(xs, ys, zs, ax.get_proj())
    rectangle = ax.get_window_extent()  # at zoom one, a square has its height or width
    side = min(rectangle.width, rectangle.height)
    across = rectangle.width / side * ax.viewLim.width / np.ptp(x)
    upright = rectangle.height / side * ax.viewLim.height / np.ptp(y)
    return fraction * float(min(across, upright))


def draw_corridor(ax: Axes3D, corridor: Corridor, color: str = BLUE) -> Axes3D:
    """Each polytope as a faint solid with its edges."""
    for faces in map(polygons, corridor.distinct()):
        edges = [np.vstack([face, face[:1]]) for face in faces]
        ax.add_collection3d(Poly3DCollection(faces, facecolor=color, alpha=0.045, zorder=2))
        ax.add_collection3d(Line3DCollection(edges, colors=color, linewidths=0.7, alpha=0.45, zorder=3))
    ax.plot([], [], [], color=color, linewidth=5, alpha=0.25, label="corridor")
    return ax


def draw_obstacles(ax: Axes3D, points: Array, low: Array, high: Array, most: int = 6000) -> Axes3D:
    """The part of a point cloud within the picture, thinned evenly to at most ``most`` points."""
    points = _within(points, low, high)
    points = points[:: max(1, -(-len(points) // most))]
    shade = np.clip((points[:, 2] - low[2]) / (high[2] - low[2]), 0.0, 1.0)
    style: dict[str, Any] = {"s": 2.2, "cmap": "Greys_r", "vmin": -0.6, "vmax": 1.6, "linewidths": 0}
    ax.scatter(*points.T, c=shade, depthshade=False, zorder=1, **style)  # low ones darker
    ax.plot([], [], [], "o", color=GREY, markersize=2.5, linestyle="none", label="obstacle points")
    return ax


def _within(points: Array, low: Array, high: Array) -> Array:
    return points[np.all((points >= low) & (points <= high), axis=1)]


def draw_ellipsoids(ax: Axes3D, zones: Ellipsoids | None, color: str, name: str) -> Axes3D:
    """Each ellipsoid as a faint solid with its lines of latitude and longitude."""
    if zones is None:
        return ax
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    ball = np.stack([np.cos(around) * np.sin(up), np.sin(around) * np.sin(up), np.cos(up)], axis=-1)
    for centre, shape in zip(np.asarray(zones.centres), np.asarray(zones.shapes), strict=True):
        x, y, z = np.moveaxis(centre + ball @ np.linalg.inv(shape).T, -1, 0)
        ax.plot_surface(x, y, z, color=color, alpha=0.25, linewidth=0, shade=False, zorder=4)
        ax.plot_wireframe(x, y, z, color=color, linewidth=0.5, alpha=0.6, rstride=3, cstride=4, zorder=4)
    ax.plot([], [], [], color=color, linewidth=5, alpha=0.4, label=name)
    return ax


def draw_landing_cone(ax: Axes3D, goal: BodyState, angle: float, height: float = 1.2) -> Axes3D:
    """The landing cone from the goal along the deck's normal, ``height`` metres of it; ``angle`` in rad."""
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 37), np.array([0.0, height]))
    radius = up / np.tan(angle)
    deck = np.asarray(rotations.rotation_matrix(goal.attitude))
    surface = np.stack([radius * np.cos(around), radius * np.sin(around), up], axis=-1) @ deck.T
    x, y, z = np.moveaxis(np.asarray(goal.position) + surface, -1, 0)
    ax.plot_surface(x, y, z, color=GOAL, alpha=0.3, linewidth=0, shade=False, zorder=4)
    ax.plot(x[1], y[1], z[1], color=GOAL, linewidth=1.0, zorder=4)
    ax.plot([], [], [], color=GOAL, linewidth=5, alpha=0.5, label="landing cone")
    return ax


def draw_body_axes(ax: Axes3D, nodes: Curves, length: float, every: int | None = None) -> Axes3D:
    """Body x, y and z axes at every n-th node (about ten of them by default)."""
    every = every or max(1, round(len(nodes.time) / 10))
    origin = nodes.state[::every, :3]
    frames = np.asarray(jax.vmap(rotations.rotation_matrix)(jnp.asarray(nodes.state[::every, 6:10])))
    for axis, (name, color) in enumerate(zip("xyz", BODY_AXES, strict=True)):
        tips = origin + length * frames[:, :, axis]
        lines = Line3DCollection(np.stack([origin, tips], axis=1), colors=color, linewidths=1.6, zorder=5)
        ax.add_collection3d(lines)
        ax.plot([], [], [], color=color, linewidth=1.6, label=f"body {name}")
    return ax


def _mark_ends(ax: Axes3D, start: BodyState, goal: BodyState) -> None:
    for state, marker, name, color in ((start, "s", "start", START), (goal, "*", "goal", GOAL)):
        ax.plot(
            *np.asarray(state.position)[:, None],
            marker,
            color=color,
            markersize=7 if marker == "s" else 12,
            markeredgecolor="white",
            zorder=8,
            label=name,
        )


def _bounds(scenario: LandingScenario, nodes: Curves, margin: float = 0.3) -> tuple[Array, Array]:
    """Corners of a box around corridor and nodes."""
    faces = [face for cell in scenario.corridor.distinct() for face in polygons(cell)]
    points = np.vstack([*faces, nodes.state[:, :3]])
    return points.min(axis=0) - margin, points.max(axis=0) + margin
