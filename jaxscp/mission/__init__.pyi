# Imported on first use: see ``__init__.py``.

from .phases import Phase as Phase
from .phases import phase_names as phase_names
from .pilot import Pilot as Pilot
from .pilot import PilotState as PilotState
from .rules import Rules as Rules
