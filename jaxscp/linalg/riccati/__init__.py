"""The Newton system of an optimal control problem (``system``), by a Riccati recursion.

Backwards along the chain, the controls at an interval's end are minimised over, which needs that the problem is convex
in the directions that its dynamics leave free: the second-order condition of a strict minimum, and no more than that.
(A factorisation by nodes, as in ``conic.kkt``, needs every block convex.) The conditions at both ends enter as
penalties, and refinement against the system as it stands makes them exact.
"""

from jaxscp.linalg.riccati.recursion import factor, solve
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, apply, no_factor

__all__ = ["Factor", "KKTVector", "LQProblem", "apply", "factor", "no_factor", "solve"]
