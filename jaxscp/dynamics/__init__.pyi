# Imported on first use: see ``__init__.py``.

from . import airframes as airframes
from .base import Dynamics as Dynamics
from .double_integrator import DoubleIntegrator as DoubleIntegrator
from .rigid_body import RigidBody as RigidBody
