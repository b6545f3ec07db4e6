"""The recursion in C++, as compiled for this machine.

In the order in which they build on each other (products are those of ``libraries/dense.h``):

    recursion.h   the chain factored, and solved for
    handler.cc    what XLA calls: a thread a lane
"""

from pathlib import Path

import jax
import numpy as np

from jaxscp import libraries
from jaxscp.riccati.in_jax import PENALTY
from jaxscp.riccati.system import Chain, Factor, Side, no_factor

FACTOR, SOLVE = "jaxscp_riccati_factor", "jaxscp_riccati_solve"
TARGETS = (FACTOR, SOLVE)
STEM = Path(__file__).with_name("riccati")


def available() -> bool:
    """Whether it was compiled for this machine; makes it known to XLA."""
    return level() is not None


def level() -> str | None:
    """The instruction set that it is compiled for here, if it is; see ``libraries.LEVELS``."""
    return libraries.level(STEM, FACTOR) and libraries.level(STEM, SOLVE)


def factor(chain: Chain) -> Factor:
    """``in_jax.factor``, to rounding."""
    like = jax.eval_shape(no_factor, chain)
    found = _call(FACTOR, [like.value, like.lower, like.gain, like.first], chain)
    return Factor(chain, *found)


def solve(factor: Factor, right: Side, refinements: int) -> Side:
    """``in_jax.solve``, to rounding."""
    return Side(*_call(SOLVE, jax.tree.leaves(right), (factor, right), refinements=np.int64(refinements)))


def _call(target: str, like, args, **attributes):
    results = [jax.ShapeDtypeStruct(v.shape, v.dtype) for v in like]
    call = jax.ffi.ffi_call(target, results, vmap_method="broadcast_all")
    return call(*jax.tree.leaves(args), penalty=np.float64(PENALTY), **attributes)
