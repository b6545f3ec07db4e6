# Imported on first use: see ``__init__.py``.

from .aerodynamics import Aerodynamics as Aerodynamics
from .aerodynamics import Deck as Deck
from .gusts import Dryden as Dryden
from .motors import Motors as Motors
from .vehicles import simulated_mav as simulated_mav
