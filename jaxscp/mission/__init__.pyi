# Imported on first use: see ``__init__.py``.

from .cases import Case as Case
from .cases import Choices as Choices
from .cases import Request as Request
from .cases import draw_case as draw_case
from .crew import Crew as Crew
from .crew import WorkerCrews as WorkerCrews
from .crew import workers as workers
from .fields import FIELDS as FIELDS
from .fields import INDOOR as INDOOR
from .fields import MOST_DECK_SPEED as MOST_DECK_SPEED
from .fields import MOST_SEED as MOST_SEED
from .fields import MOST_WIND as MOST_WIND
from .fields import OUTDOOR as OUTDOOR
from .fields import Field as Field
from .mission import Mission as Mission
from .outcome import Outcome as Outcome
from .outcome import assess as assess
from .phases import Phase as Phase
from .phases import phase_names as phase_names
from .pilot import Pilot as Pilot
from .pilot import PilotState as PilotState
from .rules import Rules as Rules
from .runs import run_mission as run_mission
from .runs import run_missions as run_missions
