# Imported when first used: see ``__init__.py``.

from .build import CorridorResult as CorridorResult
from .build import CorridorStatus as CorridorStatus
from .build import build_corridor as build_corridor
from .build import pad as pad
from .cells import Chain as Chain
from .cells import chain as chain
from .clouds import PointCloud as PointCloud
from .decompose import Cell as Cell
from .decompose import Decomposition as Decomposition
from .decompose import EllipsoidDecomposition as EllipsoidDecomposition
from .decompose import InflationFIRI as InflationFIRI
from .drawing import draw as draw
from .polytopes import Corridor as Corridor
from .polytopes import Polytope as Polytope
from .polytopes import box as box
from .polytopes import connect as connect
from .reading import CloudFileError as CloudFileError
from .reading import read_cloud as read_cloud
from .route import NoRoute as NoRoute
from .route import Route as Route
from .route import find_route as find_route
