"""Pictures of a plan: where it flies, how it flies, and how the iterations got there.

Every function draws on axes that it is given and returns them; ``summary`` makes a figure of its own. Nothing
here touches pyplot, so that importing and plotting change no global state. Lines between nodes are the flight
that the certificate flies (controls re-integrated, no correction), not an interpolation: where a plan cuts a
corner between two nodes, the picture shows it. Dots are the planned nodes.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

import itertools
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from scipy.spatial import KDTree

from jaxscp import rotations
from jaxscp.certificate import Flight, fly
from jaxscp.corridor.polytopes import Corridor, Polytope
from jaxscp.corridor.shapes import polygons
from jaxscp.landing import landing_problem
from jaxscp.mission import LandingScenario
from jaxscp.planner import Solution
from jaxscp.status import status_names

ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILLION, PURPLE, BLACK = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
    "#000000",
)
ROTORS = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILLION, YELLOW, BLACK)
GREY = "#777777"
DASHED = {"linestyle": (0, (5, 2)), "linewidth": 1.1}
LEGEND: dict[str, Any] = {"fontsize": 8, "frameon": False}
SAMPLES = 24  # drawn points an interval

Array = np.ndarray


class Curves(NamedTuple):
    """A flight as flat arrays over time: what the histories draw."""

    time: Float[np.ndarray, "points"]
    """s"""
    state: Float[np.ndarray, "points 13"]
    control: Float[np.ndarray, "points rotors"]
    polytope: Array
    """(points,) index of the corridor polytope in force."""


def flown(scenario: LandingScenario, solution: Solution, samples: int = SAMPLES) -> Curves:
    """The plan's controls flown again from the start, densely between the nodes."""
    flight = _fly(scenario, solution, samples)
    flat = jax.tree.map(lambda v: np.asarray(v).reshape(-1, *v.shape[2:]), flight)
    return Curves(flat.time, flat.state, flat.control, np.repeat(np.asarray(solution.allocation), samples))


def planned(solution: Solution) -> Curves:
    """The plan at its nodes."""
    path = solution.trajectory
    cell = np.asarray(solution.allocation)
    return Curves(
        np.asarray(path.time), np.asarray(path.state), np.asarray(path.control), np.append(cell, cell[-1])
    )


@eqx.filter_jit
def _fly(scenario: LandingScenario, solution: Solution, samples: int) -> Flight:
    return fly(landing_problem(scenario, solution.allocation), solution.trajectory, samples)


def summary(scenario: LandingScenario, solution: Solution) -> Figure:
    """The whole plan on one page: path, histories with their limits, convergence.

    Example:
        >>> import jaxscp
        >>> from jaxscp import plot
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> solution = jaxscp.Planner(nodes=20)(scenario)
        >>> figure = plot.summary(scenario, solution)
        >>> figure.savefig("plan.png")  # doctest: +SKIP
    """
    curves, nodes = flown(scenario, solution), planned(solution)
    figure = Figure(figsize=(14.0, 9.0))
    scene = cast(Axes3D, figure.add_axes((0.0, 0.27, 0.56, 0.64), projection="3d"))
    below = figure.add_gridspec(1, 3, left=0.055, right=0.55, bottom=0.065, top=0.225, wspace=0.42)
    right = figure.add_gridspec(5, 1, left=0.635, right=0.885, bottom=0.065, top=0.945, hspace=0.12)
    draw_scene(scene, scenario, curves, nodes)
    figure.legend(
        *scene.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.01, 0.95), **LEGEND, ncols=6
    )
    draw_convergence(below.subplots(), solution)
    histories = draw_histories(right.subplots(sharex=True), scenario, curves, nodes)
    figure.align_ylabels(histories)
    figure.suptitle(headline(solution), y=0.98, fontsize=12)
    return figure


def headline(solution: Solution) -> str:
    """What the picture shows, in one line; the worst violation in SI units."""
    between = np.asarray(solution.certificate.between_nodes)
    worst = solution.certificate.names[int(between.argmax())]
    status = str(status_names(solution.status)).replace("_", " ")
    return (
        f"{status} after {int(solution.iterations)} iterations:  "
        f"cost {float(solution.cost):.4g},  flight time {float(solution.final_time):.2f} s,  "
        f"worst violation between nodes {between.max():.2g} ({worst})"
    )


# --- where it flies ---


def draw_scene(ax: Axes3D, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes3D:
    """Corridor, obstacles, landing cone, path and attitude in three dimensions, to one scale."""
    ax.computed_zorder = False  # the path stays visible through what is in front of it
    low, high = _bounds(scenario, nodes)
    if scenario.obstacles is not None:
        draw_obstacles(ax, np.asarray(scenario.obstacles), low, high)
    draw_corridor(ax, scenario.corridor)
    draw_landing_cone(ax, scenario)
    draw_body_axes(ax, nodes, length=0.05 * float(np.max(high - low)))
    x, y, z = curves.state[:, :3].T
    ax.plot(x, y, np.full_like(z, low[2]), color=GREY, linewidth=1.2, zorder=1, label="shadow on the ground")
    ax.plot(x, y, z, color=BLACK, linewidth=1.8, zorder=6, label="flown path")
    ax.plot(*nodes.state[:, :3].T, "o", color=BLACK, markersize=3.2, zorder=7, label="nodes")
    _mark_ends(ax, scenario)
    _to_scale(ax, low, high)
    return ax


def _to_scale(ax: Axes3D, low: Array, high: Array) -> None:
    """One scale on all axes, ticks at round metres, seen from above and aside."""
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_major_locator(MaxNLocator(8, integer=True, steps=[1, 2, 5, 10]))
    ax.view_init(elev=38, azim=-70)
    ax.set_box_aspect(high - low)
    zoom: Any = _zoom_to_fill(ax, low, high)  # a float, which matplotlib's annotation does not know
    ax.set_box_aspect(high - low, zoom=zoom)
    for artist in (*ax.lines, *ax.collections):  # the scene may reach past the square that axes clip to
        artist.set_clip_on(False)


def _zoom_to_fill(ax: Axes3D, low: Array, high: Array, share: float = 0.84) -> float:
    """Zoom at which the box fills a share of the axes' rectangle; the rest is for ticks and labels."""
    xs, ys, zs = np.array(list(itertools.product(*zip(low, high, strict=True)))).T
    x, y, _ = proj3d.proj_transform(xs, ys, zs, ax.get_proj())
    rectangle = ax.get_window_extent()  # which a square, at zoom one, has the height or the width of
    side = min(rectangle.width, rectangle.height)
    across = rectangle.width / side * ax.viewLim.width / np.ptp(x)
    upright = rectangle.height / side * ax.viewLim.height / np.ptp(y)
    return share * float(min(across, upright))


def draw_corridor(ax: Axes3D, corridor: Corridor, color: str = BLUE) -> Axes3D:
    """Each polytope as a faint solid with its edges."""
    for faces in _solids(corridor):
        edges = [np.vstack([face, face[:1]]) for face in faces]
        ax.add_collection3d(Poly3DCollection(faces, facecolor=color, alpha=0.045, zorder=2))
        ax.add_collection3d(Line3DCollection(edges, colors=color, linewidths=0.7, alpha=0.45, zorder=3))
    ax.plot([], [], [], color=color, linewidth=5, alpha=0.25, label="corridor")
    return ax


def _solids(corridor: Corridor) -> list[list[Array]]:
    """Faces of each polytope; repeated ones, as padding leaves them, only once."""
    cells = zip(np.asarray(corridor.normals), np.asarray(corridor.offsets), strict=True)
    distinct = {(normals.tobytes(), offsets.tobytes()): (normals, offsets) for normals, offsets in cells}
    return [polygons(Polytope(*map(jnp.asarray, cell))) for cell in distinct.values()]


def draw_obstacles(ax: Axes3D, points: Array, low: Array, high: Array, most: int = 6000) -> Axes3D:
    """The part of a point cloud within the picture, thinned evenly to at most ``most`` points."""
    points = points[np.all((points >= low) & (points <= high), axis=1)]
    points = points[:: max(1, -(-len(points) // most))]
    shade = np.clip((points[:, 2] - low[2]) / (high[2] - low[2]), 0.0, 1.0)
    style: dict[str, Any] = {"s": 2.2, "cmap": "Greys_r", "vmin": -0.6, "vmax": 1.6, "linewidths": 0}
    ax.scatter(*points.T, c=shade, depthshade=False, zorder=1, **style)  # low ones darker
    ax.plot([], [], [], "o", color=GREY, markersize=2.5, linestyle="none", label="obstacle points")
    return ax


def draw_landing_cone(ax: Axes3D, scenario: LandingScenario, height: float = 1.2) -> Axes3D:
    """The landing cone from the goal upwards, ``height`` metres of it."""
    apex = np.asarray(scenario.goal.position)
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 37), np.array([0.0, height]))
    radius = up / np.tan(float(scenario.cone_angle))
    x, y, z = apex[0] + radius * np.cos(around), apex[1] + radius * np.sin(around), apex[2] + up
    ax.plot_surface(x, y, z, color=ORANGE, alpha=0.22, linewidth=0, shade=False, zorder=4)
    ax.plot(x[1], y[1], z[1], color=ORANGE, linewidth=1.0, zorder=4)
    ax.plot([], [], [], color=ORANGE, linewidth=5, alpha=0.5, label="landing cone")
    return ax


def draw_body_axes(ax: Axes3D, nodes: Curves, length: float, every: int | None = None) -> Axes3D:
    """Body x, y and z axes at every n-th node (about ten of them by default)."""
    every = every or max(1, round(len(nodes.time) / 10))
    origin = nodes.state[::every, :3]
    frames = np.asarray(jax.vmap(rotations.rotation_matrix)(jnp.asarray(nodes.state[::every, 6:10])))
    for axis, (name, color) in enumerate(zip("xyz", (VERMILLION, GREEN, BLUE), strict=True)):
        tips = origin + length * frames[:, :, axis]
        lines = Line3DCollection(np.stack([origin, tips], axis=1), colors=color, linewidths=1.6, zorder=5)
        ax.add_collection3d(lines)
        ax.plot([], [], [], color=color, linewidth=1.6, label=f"body {name}")
    return ax


def _mark_ends(ax: Axes3D, scenario: LandingScenario) -> None:
    for state, marker, name in ((scenario.start, "s", "start"), (scenario.goal, "*", "goal")):
        ax.plot(
            *np.asarray(state.position)[:, None],
            marker,
            color=VERMILLION,
            markersize=7 if marker == "s" else 12,
            markeredgecolor="white",
            zorder=8,
            label=name,
        )


def _bounds(scenario: LandingScenario, nodes: Curves, margin: float = 0.3) -> tuple[Array, Array]:
    """Corners of a box around corridor and nodes."""
    faces = [face for solid in _solids(scenario.corridor) for face in solid]
    points = np.vstack([*faces, nodes.state[:, :3]])
    return points.min(axis=0) - margin, points.max(axis=0) + margin


# --- how it flies ---


def draw_histories(axes: Any, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Any:
    """Speed, tilt, body rate, thrusts and clearance over time on five axes, limits dashed."""
    draw_speed(axes[0], curves, nodes)
    _legend_beside(axes[0])
    draw_tilt(axes[1], curves, nodes)
    draw_body_rate(axes[2], curves, nodes)
    draw_thrusts(axes[3], scenario, curves, nodes)
    draw_clearance(axes[4], scenario, curves, nodes)
    for ax in axes:
        ax.grid(color="0.9")
        ax.set_axisbelow(True)
        ax.margins(x=0.01)
    axes[-1].set_xlabel("time [s]")
    return axes


def draw_speed(ax: Axes, curves: Curves, nodes: Curves) -> Axes:
    """Speed in m/s."""
    return _curve(ax, curves, nodes, lambda c: np.linalg.norm(c.state[:, 3:6], axis=1), "speed [m/s]")


def draw_tilt(ax: Axes, curves: Curves, nodes: Curves) -> Axes:
    """Angle between the body's z axis and the vertical, in degrees."""
    angle = jax.vmap(rotations.tilt)
    return _curve(ax, curves, nodes, lambda c: np.degrees(angle(jnp.asarray(c.state[:, 6:10]))), "tilt [deg]")


def draw_body_rate(ax: Axes, curves: Curves, nodes: Curves) -> Axes:
    """Norm of the body rate in degrees per second."""
    rate = lambda c: np.degrees(np.linalg.norm(c.state[:, 10:13], axis=1))  # noqa: E731
    return _curve(ax, curves, nodes, rate, "body rate [deg/s]")


def draw_thrusts(ax: Axes, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes:
    """Thrust of each rotor in N, with the least and the greatest that it can give."""
    for rotor in range(nodes.control.shape[1]):
        color = ROTORS[rotor % len(ROTORS)]
        ax.plot(curves.time, curves.control[:, rotor], color=color, linewidth=1.2, label=f"rotor {rotor + 1}")
        ax.plot(nodes.time, nodes.control[:, rotor], "o", color=color, markersize=2.5)
    limits = {*np.asarray(scenario.airframe.thrust_min), *np.asarray(scenario.airframe.thrust_max)}
    for index, limit in enumerate(sorted(map(float, limits))):
        ax.axhline(limit, color=VERMILLION, **DASHED, label="limits" if index == 0 else None)
    ax.set_ylabel("thrust [N]")
    _legend_beside(ax)
    return ax


def draw_clearance(ax: Axes, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes:
    """Distance in m to the corridor's nearest face (negative outside) and to the nearest obstacle point."""
    ax.plot(curves.time, corridor_margin(scenario.corridor, curves), color=BLUE, label="to corridor face")
    ax.plot(nodes.time, corridor_margin(scenario.corridor, nodes), "o", color=BLUE, markersize=3)
    if scenario.obstacles is not None:
        distance, _ = KDTree(np.asarray(scenario.obstacles)).query(curves.state[:, :3])
        ax.plot(curves.time, distance, color=GREY, label="to obstacle point")
        ax.axhline(float(scenario.airframe.radius), color=GREY, **DASHED, label="vehicle radius")
    ax.axhline(0.0, color=VERMILLION, **DASHED, label="corridor limit")
    bottom, top = ax.get_ylim()
    ax.axhspan(min(bottom, 0.0), 0.0, color=VERMILLION, alpha=0.08, linewidth=0)
    ax.set(ylabel="clearance [m]", ylim=(bottom, top))
    _legend_beside(ax)
    return ax


def corridor_margin(corridor: Corridor, curves: Curves) -> Array:
    """Distance in m from each point to the nearest face of the polytope in force; negative outside it."""
    normals = np.asarray(corridor.normals)[curves.polytope]
    along = np.einsum("pfc,pc->pf", normals, curves.state[:, :3])
    depth = np.asarray(corridor.offsets)[curves.polytope] - along
    used = np.linalg.norm(normals, axis=2) > 1e-9
    return np.min(np.where(used, depth, np.inf), axis=1)


def _curve(ax: Axes, curves: Curves, nodes: Curves, quantity: Any, label: str) -> Axes:
    """One quantity: a line as flown, dots as planned."""
    ax.plot(curves.time, quantity(curves), color=BLUE, linewidth=1.5, label="flown")
    ax.plot(nodes.time, quantity(nodes), "o", color=BLACK, markersize=3, label="nodes")
    ax.set_ylabel(label)
    return ax


def _legend_beside(ax: Axes) -> None:
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **LEGEND)


# --- how the iterations got there ---


def draw_convergence(axes: Any, solution: Solution) -> Any:
    """Cost, flight time, and what should vanish over the iterations, on three axes."""
    rows = history_rows(solution)
    count = np.arange(1, int(solution.iterations) + 1)
    axes[0].plot(count, rows["cost"], "o-", color=BLUE, markersize=4, linewidth=1.2)
    axes[0].set_ylabel("cost")
    axes[1].plot(count, rows["final_time"], "o-", color=BLUE, markersize=4, linewidth=1.2)
    axes[1].set_ylabel("flight time [s]")
    draw_residuals(axes[2], count, rows)
    for ax in axes:
        ax.set_xlabel("iteration")
        ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.grid(color="0.9")
        ax.set_axisbelow(True)
    return axes


def draw_residuals(ax: Axes, count: Array, rows: dict[str, Array]) -> Axes:
    """Largest step, virtual control and defect of each iteration, norms over mixed SI units."""
    styles = {"step": (BLUE, "o"), "virtual": (ORANGE, "s"), "defect": (GREEN, "^")}
    labels = {"step": "step |Δz|", "virtual": "virtual control |ν|", "defect": "defect"}
    for name, (color, marker) in styles.items():
        value = np.where(rows[name] > 0.0, rows[name], np.nan)  # zero has no logarithm
        ax.plot(count, value, marker + "-", color=color, markersize=4, linewidth=1.2, label=labels[name])
    ax.set(yscale="log", ylabel="largest norm (SI)")
    ax.legend(loc="lower right", bbox_to_anchor=(1.05, 1.0), ncols=3, columnspacing=1.0, **LEGEND)
    return ax


def history_rows(solution: Solution) -> dict[str, Array]:
    """Each quantity of the history by name, one value an iteration that was made."""
    done = int(solution.iterations)
    return {name: np.asarray(value)[:done] for name, value in vars(solution.history).items()}
