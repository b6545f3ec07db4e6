"""Pictures of the gallery: a path on the left, histories with their limits on the right."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import jaxscp as js
from jaxscp.core.picture_style import BLACK, BLUE, DASHED, GREEN, LEGEND, ORANGE, PURPLE, VERMILLION
from jaxscp.verification.integrator.integrate import integrate

OBSTACLE: dict[str, Any] = {"facecolor": "0.87", "edgecolor": "0.55", "linewidth": 0.8}
COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
SAMPLES = 20  # drawn points an interval
SIZE = (9.0, 4.2)  # inches


class Curves(NamedTuple):
    """A trajectory as flat arrays, dense between the nodes."""

    time: np.ndarray
    """(points,) in s"""
    state: np.ndarray
    """(points, states), by integrating the controls"""
    control: np.ndarray
    """(points, controls)"""


class History(NamedTuple):
    """One panel on the right."""

    label: str
    values: Callable[[np.ndarray, np.ndarray], Any]
    """(states, controls) -> (points,) or (points, curves)"""
    limits: tuple[Any, ...] = ()
    names: tuple[str, ...] = ()
    """Of the curves, for a legend."""


@eqx.filter_jit
def _curves(dynamics: js.Dynamics, path: js.Trajectory) -> tuple:
    first, last = path.interval_controls()
    part = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    s0, s1 = path.dilation[:-1, None], path.dilation[1:, None]
    elapsed = (s0 * part[:, 0] + 0.5 * (s1 - s0) * part[:, 0] ** 2) / (path.nodes - 1)
    control = (1.0 - part) * first[:, None] + part * last[:, None]
    return path.time[:-1, None] + elapsed, integrate(dynamics, path, SAMPLES), control


def curves_of(problem: js.OptimalControlProblem, solution: js.Solution) -> Curves:
    """The planned controls, integrated from the first state; dynamics that read the time are not supported."""
    found = _curves(problem.dynamics, solution.trajectory)
    return Curves(*jax.tree.map(lambda v: np.asarray(v).reshape(-1, *v.shape[2:]), found))


def page(
    problem: js.OptimalControlProblem,
    solution: js.Solution,
    labels: Sequence[str],
    histories: Sequence[History],
    place: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[Figure, Any]:
    """The picture of a solution; add obstacles to the axes of its path.

    Args:
        problem: that was solved.
        solution: of it.
        labels: of the path's two or three axes.
        histories: panels on the right, from top to bottom.
        place: from states to the drawn path, the first states by default.

    Returns:
        The figure, and the axes of the path.
    """
    curves, nodes = curves_of(problem, solution), solution.trajectory
    figure = Figure(figsize=SIZE)
    right = figure.add_gridspec(len(histories), 1, left=0.62, right=0.98, top=0.9, bottom=0.12, hspace=0.15)
    _histories(right.subplots(sharex=True, squeeze=False)[:, 0], curves, nodes, histories)
    place = place or (lambda x: x[:, : len(labels)])
    path = _path_axes(figure, labels)
    path.plot(*place(curves.state).T, color=BLUE, linewidth=1.6)
    at = place(np.asarray(nodes.state)).T
    path.plot(*at, ".", color=BLUE, markersize=4)
    path.plot(*at[:, :1], "o", color=GREEN, label="start")
    path.plot(*at[:, -1:], "s", color=VERMILLION, label="end")
    figure.suptitle(_headline(solution), x=0.5, y=0.97, fontsize=10)
    return figure, path


def _path_axes(figure: Figure, labels: Sequence[str]) -> Any:
    if len(labels) == 2:
        path = figure.add_axes((0.075, 0.12, 0.44, 0.78))
        path.grid(color="0.93")
        path.set_axisbelow(True)
    else:
        path = figure.add_axes((0.0, 0.02, 0.54, 0.9), projection="3d")
        path.set(zlabel=labels[2])
    path.set(xlabel=labels[0], ylabel=labels[1])
    return path


def _histories(
    axes: Sequence[Axes], curves: Curves, nodes: js.Trajectory, histories: Sequence[History]
) -> None:
    for ax, history in zip(axes, histories, strict=True):
        dense = _columns(history.values(curves.state, curves.control))
        dots = _columns(history.values(np.asarray(nodes.state), np.asarray(nodes.control)))
        for number, (line, dot) in enumerate(zip(dense.T, dots.T, strict=True)):
            colour = COLOURS[number % len(COLOURS)]
            name = history.names[number] if history.names else None
            ax.plot(curves.time, line, color=colour, linewidth=1.3, label=name)
            ax.plot(np.asarray(nodes.time), dot, ".", color=colour, markersize=3)
        for limit in history.limits:
            ax.axhline(float(limit), color=BLACK, **DASHED)
        if history.names:
            ax.legend(**LEGEND, ncols=len(history.names), loc="best")
        ax.set_ylabel(history.label, fontsize=9)
        ax.grid(color="0.93")
        ax.margins(x=0.0, y=0.08)
    axes[-1].set_xlabel("time in s")
    axes[0].figure.align_ylabels(list(axes))  # pyright: ignore[reportAttributeAccessIssue]


def _columns(values: Any) -> np.ndarray:
    values = np.asarray(values)
    return values[:, None] if values.ndim == 1 else values


def _headline(solution: js.Solution) -> str:
    status = str(js.status_names(solution.status)).replace("_", " ")
    return (
        f"{status} after {int(solution.iterations)} subproblems:  cost {float(solution.cost):.5g},  "
        f"final time {float(solution.final_time):.4g} s"
    )
