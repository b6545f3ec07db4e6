# Imported on first use: see ``__init__.py``.

from .aerodynamics import Aerodynamics as Aerodynamics
from .aerodynamics import Deck as Deck
from .estimator import ErrorStateFilter as ErrorStateFilter
from .estimator import Estimate as Estimate
from .geometric import Geometric as Geometric
from .gusts import Dryden as Dryden
from .motors import Motors as Motors
from .scene import Scene as Scene
from .scene import indoor as indoor
from .scene import outdoor as outdoor
from .sensors import IMU as IMU
from .sensors import DeckSensor as DeckSensor
from .sensors import LiDAR as LiDAR
from .sensors import Odometry as Odometry
from .simulate import Flight as Flight
from .simulate import Sensors as Sensors
from .simulate import simulate as simulate
from .vehicles import simulated_mav as simulated_mav
from .world import World as World
from .world import WorldState as WorldState
from .world import carrier_state as carrier_state
from .world import open_loop as open_loop
from .world import vehicle_state as vehicle_state
