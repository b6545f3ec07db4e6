"""Figures at the width of a paper's column."""

from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from jaxscp.core.picture_style import COLUMN, DPI
from jaxscp.landing.scenario import LandingScenario
from jaxscp.plot.above import draw_above
from jaxscp.plot.curves import integrated, planned
from jaxscp.plot.panels import draw_histories
from jaxscp.plot.space import draw_scene
from jaxscp.solver.solution import Solution


def scene(scenario: LandingScenario, solution: Solution) -> Figure:
    """The path in three dimensions, and from above, at the width of a paper's column.

    Args:
        scenario: that was planned.
        solution: its plan.

    Returns:
        A figure, 3.5 inches wide, of 200 dots per inch.

    Example:
        >>> from jaxscp import plot
        >>> plot.scene.__name__  # plot.scene(scenario, solution).savefig("scene.pdf")
        'scene'
    """
    curves, nodes = integrated(scenario, solution), planned(solution)
    figure = Figure(figsize=(COLUMN, 1.35 * COLUMN), dpi=DPI)
    space = cast(Axes3D, figure.add_axes((0.0, 0.46, 0.88, 0.42), projection="3d"))
    draw_scene(space, scenario, curves, nodes, every=max(1, len(nodes.time) // 6))
    handles, labels = space.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper center", ncols=3, fontsize=5.5, frameon=False, columnspacing=1.0
    )
    above = draw_above(figure.add_axes((0.13, 0.09, 0.83, 0.33)), scenario, curves, nodes)
    for ax in (space, above):
        _small(ax)
    return figure


def histories(scenario: LandingScenario, solution: Solution) -> Figure:
    """Speed, tilt, body rate, thrusts and clearance over time, at the width of a paper's column.

    Args:
        scenario: that was planned.
        solution: its plan.

    Returns:
        A figure, 3.5 inches wide, of 200 dots per inch.

    Example:
        >>> from jaxscp import plot
        >>> plot.histories.__name__  # plot.histories(scenario, solution).savefig("histories.pdf")
        'histories'
    """
    figure = Figure(figsize=(COLUMN, 1.6 * COLUMN), dpi=DPI)
    grid = figure.add_gridspec(5, 1, left=0.15, right=0.67, bottom=0.07, top=0.985, hspace=0.14)
    axes = list(np.ravel(grid.subplots(sharex=True)))  # pyright: ignore[reportCallIssue, reportArgumentType]
    draw_histories(axes, scenario, integrated(scenario, solution), planned(solution))
    for ax in axes:
        _small(ax)
        for line in ax.lines:
            line.set_markersize(0.6 * line.get_markersize())
            line.set_linewidth(0.75 * line.get_linewidth())
    figure.align_ylabels(axes)
    return figure


def _small(ax: Any) -> None:
    """Texts of 6 points."""
    ax.tick_params(labelsize=6, pad=0 if isinstance(ax, Axes3D) else 2)
    for axis in (ax.xaxis, ax.yaxis, *((ax.zaxis,) if isinstance(ax, Axes3D) else ())):
        axis.label.set_size(6.5)  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(ax, Axes3D):
            axis.labelpad = -9 if axis is ax.zaxis else -4
    if (legend := ax.get_legend()) is not None:
        for text in legend.get_texts():
            text.set_fontsize(5.5)
