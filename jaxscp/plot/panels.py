"""Histories: speed, tilt, body rate, thrusts and clearance over time, with their limits."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from scipy.spatial import KDTree

from jaxscp.core.picture_style import BLACK, BLUE, DASHED, GREY, LEGEND, LIMIT, PURPLE, SKY
from jaxscp.core.types import Scalar
from jaxscp.dynamics import rotations
from jaxscp.landing.scenario import LandingScenario
from jaxscp.plot.curves import Curves, union_margin, zone_margin


def draw_histories(axes: Any, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Any:
    """Speed, tilt, body rate, thrusts and clearance over time on five axes, limits dashed."""
    limits = [scenario.limits.speed, scenario.limits.tilt, scenario.limits.body_rate]
    for ax, draw, limit in zip(axes, (draw_speed, draw_tilt, draw_body_rate), limits, strict=False):
        draw(ax, curves, nodes, limit)
    limited = [ax for ax, limit in zip(axes, limits, strict=False) if limit is not None]
    _legend_beside([*limited, axes[0]][0])
    draw_thrusts(axes[3], scenario, curves, nodes)
    draw_clearance(axes[4], scenario, curves, nodes)
    for ax in axes:
        ax.grid(color="0.9")
        ax.set_axisbelow(True)
        ax.margins(x=0.01)
    axes[-1].set_xlabel("time [s]")
    return axes


def draw_speed(ax: Axes, curves: Curves, nodes: Curves, limit: Scalar | None = None) -> Axes:
    """Speed in m/s, and the limit in m/s if there is one."""
    speed = lambda c: np.linalg.norm(c.state[:, 3:6], axis=1)  # noqa: E731
    return _curve(ax, curves, nodes, speed, "speed [m/s]", limit)


def draw_tilt(ax: Axes, curves: Curves, nodes: Curves, limit: Scalar | None = None) -> Axes:
    """Angle between the body's z axis and the vertical in degrees, and its limit, given in rad."""
    angle = jax.vmap(rotations.tilt)
    tilt = lambda c: np.degrees(angle(jnp.asarray(c.state[:, 6:10])))  # noqa: E731
    return _curve(ax, curves, nodes, tilt, "tilt [deg]", None if limit is None else np.degrees(limit))


def draw_body_rate(ax: Axes, curves: Curves, nodes: Curves, limit: Scalar | None = None) -> Axes:
    """Norm of the body rate in degrees per second, and its limit, given in rad/s."""
    rate = lambda c: np.degrees(np.linalg.norm(c.state[:, 10:13], axis=1))  # noqa: E731
    return _curve(ax, curves, nodes, rate, "body rate [deg/s]", None if limit is None else np.degrees(limit))


def draw_thrusts(ax: Axes, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes:
    """Rotor thrusts in N: a band from the least to the greatest, their mean, and the limits of all rotors."""
    least, most = curves.control.min(axis=1), curves.control.max(axis=1)
    ax.fill_between(curves.time, least, most, color=SKY, alpha=0.45, linewidth=0, label="all rotors")
    ax.plot(curves.time, curves.control.mean(axis=1), color=BLUE, linewidth=1.5, label="mean")
    ax.plot(nodes.time, nodes.control.mean(axis=1), "o", color=BLACK, markersize=3)
    limits = {*np.asarray(scenario.airframe.thrust_min), *np.asarray(scenario.airframe.thrust_max)}
    for index, limit in enumerate(sorted(map(float, limits))):
        ax.axhline(limit, color=LIMIT, **DASHED, label="limits" if index == 0 else None)
    ax.set_ylabel("thrust [N]")
    _legend_beside(ax)
    return ax


def draw_clearance(ax: Axes, scenario: LandingScenario, curves: Curves, nodes: Curves) -> Axes:
    """Clearance in m to the union of polytopes (negative outside), to keep-out zones and to obstacle points."""
    ax.plot(curves.time, union_margin(scenario.corridor, curves), color=BLUE, label="centre to corridor")
    ax.plot(nodes.time, union_margin(scenario.corridor, nodes), "o", color=BLACK, markersize=3)
    if scenario.keep_out is not None and scenario.keep_out.centres.shape[0]:
        ax.plot(curves.time, zone_margin(scenario.keep_out, curves), color=PURPLE, label="centre to zone")
    if scenario.obstacles is not None:
        distance, _ = KDTree(np.asarray(scenario.obstacles)).query(curves.state[:, :3])
        ax.plot(curves.time, distance, color=GREY, label="centre to obstacles")
        ax.axhline(float(scenario.airframe.radius), color=GREY, **DASHED, label="radius of the hull")
    ax.axhline(0.0, color=LIMIT, **DASHED, label="limit")
    bottom, top = ax.get_ylim()
    ax.axhspan(min(bottom, 0.0), 0.0, color=LIMIT, alpha=0.08, linewidth=0)
    ax.set(ylabel="clearance [m]", ylim=(bottom, top))
    _legend_beside(ax)
    return ax


def _curve(ax: Axes, curves: Curves, nodes: Curves, quantity: Any, label: str, limit: Any = None) -> Axes:
    """One quantity: a line as flown, dots as planned, and its limit dashed."""
    ax.plot(curves.time, quantity(curves), color=BLUE, linewidth=1.5, label="integrated")
    ax.plot(nodes.time, quantity(nodes), "o", color=BLACK, markersize=3, label="nodes")
    if limit is not None:
        ax.axhline(float(limit), color=LIMIT, **DASHED, label="limit")
    ax.set_ylabel(label)
    return ax


def _legend_beside(ax: Axes) -> None:
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **LEGEND)
