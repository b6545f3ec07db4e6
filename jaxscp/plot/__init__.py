"""Pictures of a plan: where it flies, how it flies, and how the iterations got there.

Every function draws on axes that it is given and returns them; ``summary`` makes a figure of its own. Nothing
here touches pyplot, so that importing and plotting change no global state. Lines between nodes are the flight
that the certificate flies (controls re-integrated, no correction), not an interpolation: where a plan cuts a
corner between two nodes, the picture shows it. Dots are the planned nodes.
"""

from jaxscp.plot.convergence import draw_convergence as draw_convergence
from jaxscp.plot.convergence import draw_residuals as draw_residuals
from jaxscp.plot.convergence import history_rows as history_rows
from jaxscp.plot.curves import Curves as Curves
from jaxscp.plot.curves import corridor_margin as corridor_margin
from jaxscp.plot.curves import flown as flown
from jaxscp.plot.curves import planned as planned
from jaxscp.plot.histories import draw_body_rate as draw_body_rate
from jaxscp.plot.histories import draw_clearance as draw_clearance
from jaxscp.plot.histories import draw_histories as draw_histories
from jaxscp.plot.histories import draw_speed as draw_speed
from jaxscp.plot.histories import draw_thrusts as draw_thrusts
from jaxscp.plot.histories import draw_tilt as draw_tilt
from jaxscp.plot.page import headline as headline
from jaxscp.plot.page import summary as summary
from jaxscp.plot.scene import draw_body_axes as draw_body_axes
from jaxscp.plot.scene import draw_corridor as draw_corridor
from jaxscp.plot.scene import draw_ellipsoids as draw_ellipsoids
from jaxscp.plot.scene import draw_landing_cone as draw_landing_cone
from jaxscp.plot.scene import draw_obstacles as draw_obstacles
from jaxscp.plot.scene import draw_scene as draw_scene
