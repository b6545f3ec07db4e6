"""Pictures of a mission: both paths from two views, take-off, errors, touch-downs, an animation."""

import os
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from jaxscp.core.picture_style import BLACK, BLUE, DASHED, GOAL, GREY, LEGEND, LIMIT, ORANGE, START
from jaxscp.mission.mission import Mission
from jaxscp.mission.outcome import Outcome
from jaxscp.simulation import Scene
from jaxscp.simulation.bodies import DECK_HEIGHT
from jaxscp.simulation.simulate import TICK
from jaxscp.simulation.vehicles import FEET_DEPTH

_FRAMES = 8  # a second of an animation, each for a quarter of a second of flight
_SKIP = 50  # samples between frames


def page(mission: Mission) -> Figure:
    """Four panels: from above, from the side, take-off, errors."""
    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    above, side, start, errors = figure.subplots(2, 2).ravel()
    draw_view(above, mission, (0, 1))
    draw_view(side, mission, (1, 2))
    side.legend(loc="lower center", bbox_to_anchor=(0.5, 1.02), **LEGEND)  # free space beside the narrow view
    draw_take_off(start, mission)
    draw_errors(errors, mission)
    return figure


def draw_view(ax: Axes, mission: Mission, axes: tuple[int, int]) -> Axes:
    """Obstacles, plans and the true path along two of the world's axes, in metres."""
    flight = mission.record.flight()
    a, b = axes
    draw_scene(ax, mission.case.scene, axes)
    for number, (_, planned) in enumerate(mission.commander.plans):
        if planned.trajectory is not None:
            nodes = np.asarray(planned.trajectory.state)
            label = "plans, in the frame of the odometry" if number == 0 else None
            ax.plot(nodes[:, a], nodes[:, b], color=ORANGE, label=label, **DASHED)
    ax.plot(flight.carrier[:, a], flight.carrier[:, b], color=BLUE, linewidth=2.0, label="carrier")
    ax.plot(flight.vehicle[:, a], flight.vehicle[:, b], color=BLACK, linewidth=1.2, label="vehicle, true")
    first, goal = flight.vehicle[0], np.asarray(mission.case.goal)
    ax.plot(first[a], first[b], "s", color=START, markeredgecolor="white", label="start")
    ax.plot(goal[a], goal[b], "*", color=GOAL, markersize=11, markeredgecolor="white", label="goal")
    low, high = np.array(mission.case.field.lower), np.array(mission.case.field.upper)
    ax.set(xlim=(low[a] - 1.0, high[a] + 1.0), ylim=(low[b] - 1.0, high[b] + 1.0))
    names = "xyz"
    ax.set(xlabel=f"{names[a]} [m]", ylabel=f"{names[b]} [m]", aspect="equal")
    return ax


def draw_scene(ax: Axes, scene: Scene, axes: tuple[int, int]) -> None:
    """Obstacles as their shadows on a plane of the world's axes."""
    a, b = axes
    for centre, half in zip(np.asarray(scene.centres), np.asarray(scene.halves), strict=True):
        if half.max() < 4.0:  # walls are drawn as no filled shape
            corner = centre - half
            ax.add_patch(Rectangle((corner[a], corner[b]), 2 * half[a], 2 * half[b], color=GREY, alpha=0.5))
    for (x, y), radius, height in zip(
        *map(np.asarray, (scene.axes, scene.radii, scene.heights)), strict=True
    ):
        if b == 1:
            ax.add_patch(Circle((x, y), radius, color=GREY, alpha=0.5))
        else:
            middle = (x, y)[a]
            ax.add_patch(Rectangle((middle - radius, 0.0), 2 * radius, height, color=GREY, alpha=0.35))


def draw_take_off(ax: Axes, mission: Mission, seconds: float = 5.0) -> Axes:
    """Thrust as a fraction of the greatest, and height over the deck, against time."""
    flight = mission.record.flight()
    count = int(seconds / TICK)
    time = np.arange(1, len(flight.vehicle) + 1)[:count] * TICK
    share = flight.thrusts[:count].sum(axis=1) / float(mission.case.world.motors.thrust_max.sum())
    height = _heights(np.asarray(flight.vehicle), np.asarray(flight.carrier))[:count]
    ax.plot(time, height, color=BLUE, label="height over the deck [m]")
    ax.plot(time, share, color=BLACK, label="thrust / greatest thrust")
    ax.set(xlabel="time [s]", ylim=(-0.05, None))
    ax.legend(loc="upper left", **LEGEND)
    return ax


def draw_errors(ax: Axes, mission: Mission) -> Axes:
    """Drift of the odometry, and the error of the deck's estimated place relative to the vehicle, against time."""
    flight = mission.record.flight()
    time = np.arange(1, len(flight.vehicle) + 1) * TICK
    drift = (flight.estimate - flight.vehicle)[:, :3]
    deck = flight.deck[:, :3] - flight.estimate[:, :3]
    truth = flight.carrier[:, :3] - flight.vehicle[:, :3]
    relative = np.linalg.norm((deck - truth)[:, :2], axis=1)
    ax.semilogy(time, np.linalg.norm(drift, axis=1) + 1e-4, color=GREY, label="own position: drift [m]")
    ax.semilogy(time, relative + 1e-4, color=BLUE, label="deck relative to the vehicle, horizontal [m]")
    ax.semilogy(time, mission.tracking_errors(), color=BLACK, label="estimated position from the plan [m]")
    ax.set(xlabel="time [s]", ylim=(1e-3, 10.0))
    ax.legend(loc="upper left", **LEGEND)
    return ax


def touchdowns(outcomes: Sequence[Outcome]) -> Figure:
    """First contacts on the deck, with circles at 1.5, 4 and 8 cm."""
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    ax = figure.subplots()
    for radius in (0.015, 0.04, 0.08):
        ax.add_patch(Circle((0.0, 0.0), 100 * radius, fill=False, color=LIMIT, linewidth=0.8))
    where = 100.0 * np.array([outcome.where for outcome in outcomes]).reshape(-1, 2)
    ax.plot(*where.T, "o", color=BLACK, markersize=3, alpha=0.6)
    ax.set(xlim=(-10, 10), ylim=(-10, 10), aspect="equal", xlabel="along the deck [cm]", ylabel="across [cm]")
    return figure


def animation(mission: Mission, file: str | os.PathLike) -> None:
    """Write a GIF: the flight from above and from the side, twice as fast as in truth."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    flight = mission.record.flight()
    points = []
    for ax, axes in zip(figure.subplots(1, 2), ((0, 1), (1, 2)), strict=True):
        draw_view(ax, mission, axes)
        carrier = ax.plot([], [], "s", color=BLUE, markersize=10)[0]
        points.append((ax.plot([], [], "o", color=LIMIT, markersize=6)[0], carrier, axes))

    def show(frame: int):
        for vehicle, carrier, (a, b) in points:
            vehicle.set_data([flight.vehicle[frame, a]], [flight.vehicle[frame, b]])
            carrier.set_data([flight.carrier[frame, a]], [flight.carrier[frame, b]])
        return [artist for vehicle, carrier, _ in points for artist in (vehicle, carrier)]

    frames = range(0, len(flight.vehicle), _SKIP)
    FuncAnimation(figure, show, frames=frames).save(os.fspath(file), writer=PillowWriter(fps=_FRAMES), dpi=70)


def _heights(vehicle: Float[np.ndarray, "ticks 13"], carrier: Float[np.ndarray, "ticks 13"]) -> np.ndarray:
    """Of the feet over the deck, m."""
    return vehicle[:, 2] - carrier[:, 2] - DECK_HEIGHT - FEET_DEPTH
