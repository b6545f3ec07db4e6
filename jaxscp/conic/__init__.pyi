# Imported on first use: see ``__init__.py``.

from .layer import ConicLayer as ConicLayer
from .layer import LayerSolution as LayerSolution
from .osqp import OSQP as OSQP
from .program import Cones as Cones
from .program import ConicMultipliers as ConicMultipliers
from .program import ConicSolution as ConicSolution
from .program import CouplingRows as CouplingRows
from .program import HalfSpaceRows as HalfSpaceRows
from .program import NormCost as NormCost
from .program import StagedProgram as StagedProgram
from .program import WarmStart as WarmStart
from .sparse import SparseProgram as SparseProgram
from .sparse import export as export
