# Imported on first use: see ``__init__.py``.

from .above import draw_above as draw_above
from .convergence import draw_convergence as draw_convergence
from .convergence import draw_residuals as draw_residuals
from .convergence import history_rows as history_rows
from .curves import Curves as Curves
from .curves import corridor_margin as corridor_margin
from .curves import integrated as integrated
from .curves import planned as planned
from .curves import union_margin as union_margin
from .curves import zone_margin as zone_margin
from .figures import histories as histories
from .figures import scene as scene
from .page import headline as headline
from .page import summary as summary
from .panels import draw_body_rate as draw_body_rate
from .panels import draw_clearance as draw_clearance
from .panels import draw_histories as draw_histories
from .panels import draw_speed as draw_speed
from .panels import draw_thrusts as draw_thrusts
from .panels import draw_tilt as draw_tilt
from .space import draw_body_axes as draw_body_axes
from .space import draw_corridor as draw_corridor
from .space import draw_ellipsoids as draw_ellipsoids
from .space import draw_landing_cone as draw_landing_cone
from .space import draw_obstacles as draw_obstacles
from .space import draw_scene as draw_scene
