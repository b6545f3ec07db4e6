"""Safe flight corridors: half-space polytopes, and how to make them from a point cloud."""

from jaxscp.corridor.build import CorridorResult as CorridorResult
from jaxscp.corridor.build import CorridorStatus as CorridorStatus
from jaxscp.corridor.build import build_corridor as build_corridor
from jaxscp.corridor.build import pad as pad
from jaxscp.corridor.cells import Chain as Chain
from jaxscp.corridor.cells import chain as chain
from jaxscp.corridor.clouds import PointCloud as PointCloud
from jaxscp.corridor.decompose import Cell as Cell
from jaxscp.corridor.decompose import Decomposition as Decomposition
from jaxscp.corridor.decompose import EllipsoidDecomposition as EllipsoidDecomposition
from jaxscp.corridor.decompose import InflationFIRI as InflationFIRI
from jaxscp.corridor.drawing import draw as draw
from jaxscp.corridor.polytopes import Corridor as Corridor
from jaxscp.corridor.polytopes import Polytope as Polytope
from jaxscp.corridor.polytopes import box as box
from jaxscp.corridor.polytopes import connect as connect
from jaxscp.corridor.reading import CloudFileError as CloudFileError
from jaxscp.corridor.reading import read_cloud as read_cloud
from jaxscp.corridor.route import NoRoute as NoRoute
from jaxscp.corridor.route import Route as Route
from jaxscp.corridor.route import find_route as find_route
