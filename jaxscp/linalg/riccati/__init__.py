"""Newton system of an optimal control problem (``system``), solved by a Riccati recursion.

The backward recursion minimises over the controls at each interval's end. It needs convexity only in the directions
that the dynamics leave free, the second-order condition of a strict minimum. (A factorisation by nodes, as in
``conic.kkt``, needs every block convex.) Conditions at both ends enter as penalties; refinement makes them exact.
"""

from jaxscp.linalg.riccati.recursion import factor, factor_shifted, solve
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, Shifts, apply, no_factor

__all__ = [
    "Factor",
    "KKTVector",
    "LQProblem",
    "Shifts",
    "apply",
    "factor",
    "factor_shifted",
    "no_factor",
    "solve",
]
