"""Convergence of the iterations."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxscp.core.picture_style import BLUE, GREEN, LEGEND, ORANGE
from jaxscp.plot.curves import Array
from jaxscp.solver.solution import Solution


def draw_convergence(axes: Any, solution: Solution) -> Any:
    """Cost, flight time, and residuals over the iterations, on three axes."""
    rows = history_rows(solution)
    count = np.arange(1, int(solution.iterations) + 1)
    axes[0].plot(count, rows["cost"], "o-", color=BLUE, markersize=4, linewidth=1.2)
    axes[0].set_ylabel("cost")
    axes[1].plot(count, rows["final_time"], "o-", color=BLUE, markersize=4, linewidth=1.2)
    axes[1].set_ylabel("flight time [s]")
    if bool(solution.differentiable):
        for ax, value in ((axes[0], solution.cost), (axes[1], solution.final_time)):
            ax.axhline(float(value), color="0.4", linestyle="--", linewidth=1.0, label="optimum")
            ax.legend(loc="best", **LEGEND)
    draw_residuals(axes[2], count, rows)
    for ax in axes:
        ax.set_xlabel("iteration")
        ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.grid(color="0.9")
        ax.set_axisbelow(True)
    return axes


def draw_residuals(ax: Axes, count: Array, rows: dict[str, Array]) -> Axes:
    """Largest step, virtual control and defect of each iteration, norms over mixed SI units."""
    styles = {"step_norm": (BLUE, "o"), "virtual_control": (ORANGE, "s"), "defect": (GREEN, "^")}
    labels = {"step_norm": "step |Δz|", "virtual_control": "virtual control |ν|", "defect": "defect"}
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
