"""Solvers for the convex subproblem: our structured interior point, also as a layer, and OSQP on its quadratic form."""

from jaxscp.conic.layer import ConicLayer as ConicLayer
from jaxscp.conic.layer import LayerSolution as LayerSolution
from jaxscp.conic.osqp import OSQP as OSQP
from jaxscp.conic.program import Cones as Cones
from jaxscp.conic.program import ConicSolution as ConicSolution
from jaxscp.conic.program import Links as Links
from jaxscp.conic.program import Multipliers as Multipliers
from jaxscp.conic.program import Near as Near
from jaxscp.conic.program import NormCost as NormCost
from jaxscp.conic.program import Rows as Rows
from jaxscp.conic.program import StagedProgram as StagedProgram
from jaxscp.conic.sparse import SparseProgram as SparseProgram
from jaxscp.conic.sparse import export as export
