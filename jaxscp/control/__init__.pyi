# Imported on first use: see ``__init__.py``.

from .actuators import Actuators as Actuators
from .disturbance import DisturbanceModel as DisturbanceModel
from .horizon import Horizon as Horizon
from .horizon import growing as growing
from .nmpc import NMPC as NMPC
from .nmpc import NMPCState as NMPCState
from .receding import HeldPlan as HeldPlan
from .receding import RecedingHorizon as RecedingHorizon
from .receding import replaced as replaced
from .reference import Reference as Reference
from .tracking import Tracking as Tracking
from .tracking import difference as difference
from .tracking import flight_error as flight_error
