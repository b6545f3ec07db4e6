# Imported on first use: see ``__init__.py``.

from .convergence import draw_convergence as draw_convergence
from .convergence import draw_residuals as draw_residuals
from .convergence import history_rows as history_rows
from .curves import Curves as Curves
from .curves import corridor_margin as corridor_margin
from .curves import integrated as integrated
from .curves import planned as planned
from .histories import draw_body_rate as draw_body_rate
from .histories import draw_clearance as draw_clearance
from .histories import draw_histories as draw_histories
from .histories import draw_speed as draw_speed
from .histories import draw_thrusts as draw_thrusts
from .histories import draw_tilt as draw_tilt
from .page import headline as headline
from .page import summary as summary
from .scene import draw_body_axes as draw_body_axes
from .scene import draw_corridor as draw_corridor
from .scene import draw_ellipsoids as draw_ellipsoids
from .scene import draw_landing_cone as draw_landing_cone
from .scene import draw_obstacles as draw_obstacles
from .scene import draw_scene as draw_scene
