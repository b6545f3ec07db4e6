# Imported on first use: see ``__init__.py``.

from .layer import ConicLayer as ConicLayer
from .layer import LayerSolution as LayerSolution
from .osqp import OSQP as OSQP
from .program import Cones as Cones
from .program import ConicSolution as ConicSolution
from .program import Links as Links
from .program import Multipliers as Multipliers
from .program import Near as Near
from .program import NormCost as NormCost
from .program import Rows as Rows
from .program import StagedProgram as StagedProgram
from .sparse import SparseProgram as SparseProgram
from .sparse import export as export
