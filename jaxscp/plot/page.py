"""The whole plan on one page."""

from typing import cast

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from jaxscp.core.picture_style import DPI, LEGEND
from jaxscp.core.status import status_names
from jaxscp.landing.scenario import LandingScenario
from jaxscp.plot.above import draw_above
from jaxscp.plot.convergence import draw_convergence
from jaxscp.plot.curves import integrated, planned
from jaxscp.plot.panels import draw_histories
from jaxscp.plot.space import draw_scene
from jaxscp.solver.solution import Solution


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
    curves, nodes = integrated(scenario, solution), planned(solution)
    figure = Figure(figsize=(14.0, 9.0), dpi=DPI)
    scene = cast(Axes3D, figure.add_axes((0.0, 0.5, 0.56, 0.42), projection="3d"))
    above = figure.add_axes((0.055, 0.29, 0.495, 0.19))
    below = figure.add_gridspec(1, 3, left=0.055, right=0.55, bottom=0.065, top=0.225, wspace=0.52)
    right = figure.add_gridspec(5, 1, left=0.635, right=0.885, bottom=0.065, top=0.945, hspace=0.12)
    draw_scene(scene, scenario, curves, nodes)
    draw_above(above, scenario, curves, nodes)
    figure.legend(
        *scene.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.01, 0.95), **LEGEND, ncols=6
    )
    draw_convergence(below.subplots(), solution)
    histories = draw_histories(right.subplots(sharex=True), scenario, curves, nodes)
    figure.align_ylabels(histories)
    figure.suptitle(headline(scenario, solution), y=0.98, fontsize=12)
    return figure


UNITS = {"thrust": " N", "speed": " m/s", "body rate": " rad/s", "thrust rate": " s"}
UNITS |= dict.fromkeys(("corridor", "landing cone", "keep-out"), " m")
"""Of constraints' violations; a tilt and a gate are judged in numbers without unit."""


def headline(scenario: LandingScenario, solution: Solution) -> str:
    """The picture's headline: status, cost with its weights, flight time, worst violation with its unit."""
    between = np.asarray(solution.certificate.between_nodes)
    worst = solution.certificate.names[int(between.argmax())]
    status = str(status_names(solution.status)).replace("_", " ")
    steps = int(solution.interior_point_iterations)
    end = f" and {steps} Newton steps" if steps else ""
    weights = f"{float(scenario.weights.control):g} ∫|u|dt [N s] + {float(scenario.weights.time):g} t_f [s]"
    return (
        f"{status} after {int(solution.iterations)} iterations{end}:  "
        f"cost {float(solution.cost):.4g} = {weights},  flight time {float(solution.final_time):.2f} s,  "
        f"worst violation {between.max():.2g}{UNITS.get(worst, '')} ({worst})"
    )
