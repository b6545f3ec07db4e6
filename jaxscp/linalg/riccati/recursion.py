"""The recursion, on a CPU in float64 by C++ if that was compiled, and else as JAX.

XLA runs a step along the chain as dozens of operations on matrices of a few kilobytes, and most of its time goes
between them.
"""

import functools

from jaxscp.backends.libraries import choose, in_float64
from jaxscp.linalg.riccati import in_jax, native
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem

REFINEMENTS = 3


def factor(chain: LQProblem) -> Factor:
    """Eliminate the chain from its end."""
    cpu = native.factor if _compiled(chain) else None
    return choose(cpu, in_jax.factor, chain)


def solve(factor: Factor, right: KKTVector, refinements: int = REFINEMENTS) -> KKTVector:
    """Solve for one right-hand side; without refinement, but for the penalties of the ends and for rounding."""
    refined = functools.partial(native.solve, refinements=refinements)
    cpu = refined if _compiled(factor.chain) else None
    return choose(cpu, functools.partial(in_jax.solve, refinements=refinements), factor, right)


def _compiled(chain: LQProblem) -> bool:
    return in_float64(chain) and native.LIBRARY.available()
