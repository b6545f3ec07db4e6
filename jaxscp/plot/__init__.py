"""Pictures of a plan: where it flies, how it flies, and how the iterations got there.

Every function draws on axes that it is given and returns them; ``summary`` makes a figure of its own. Nothing
here touches pyplot, so that importing and plotting change no global state. Lines between nodes are the flight
that the certificate flies (controls re-integrated, no correction), not an interpolation: where a plan cuts a
corner between two nodes, the picture shows it. Dots are the planned nodes.
"""

from jaxscp.plot.convergence import draw_convergence, draw_residuals, history_rows
from jaxscp.plot.curves import Curves, corridor_margin, flown, planned
from jaxscp.plot.histories import (
    draw_body_rate,
    draw_clearance,
    draw_histories,
    draw_speed,
    draw_thrusts,
    draw_tilt,
)
from jaxscp.plot.page import headline, summary
from jaxscp.plot.scene import (
    draw_body_axes,
    draw_corridor,
    draw_ellipsoids,
    draw_landing_cone,
    draw_obstacles,
    draw_scene,
)

__all__ = [
    "Curves",
    "corridor_margin",
    "draw_body_axes",
    "draw_body_rate",
    "draw_clearance",
    "draw_convergence",
    "draw_corridor",
    "draw_ellipsoids",
    "draw_histories",
    "draw_landing_cone",
    "draw_obstacles",
    "draw_residuals",
    "draw_scene",
    "draw_speed",
    "draw_thrusts",
    "draw_tilt",
    "flown",
    "headline",
    "history_rows",
    "planned",
    "summary",
]
