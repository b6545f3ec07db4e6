"""Riccati recursion in C++, compiled for this machine, and in CUDA.

In the order in which the files build on each other (``backends/native/dense.h`` has the products):

    recursion.h   factorisation and solution
    handler.cc    XLA FFI handlers on a CPU
    factor.cu, solve.cu   the same by a block of threads; ``gpu.py`` compiles them for the sizes of a problem
    gpu_handler.cc        XLA FFI handler that launches them
"""

import jax
import numpy as np

from jaxscp.backends import libraries
from jaxscp.linalg.riccati.in_jax import PENALTY
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, no_factor

LIBRARY = libraries.RICCATI
FACTOR, SOLVE = LIBRARY.targets


def factor(problem: LQProblem) -> Factor:
    """``in_jax.factor``, equal to rounding."""
    like = jax.eval_shape(no_factor, problem)
    found = _call(FACTOR, [like.value, like.lower, like.gain, like.first], problem)
    return Factor(problem, *found)


def solve(factor: Factor, right: KKTVector, refinements: int) -> KKTVector:
    """``in_jax.solve``, equal to rounding."""
    return KKTVector(
        *_call(SOLVE, jax.tree.leaves(right), (factor, right), refinements=np.int64(refinements))
    )


def _call(target: str, like, args, **attributes):
    results = [jax.ShapeDtypeStruct(v.shape, v.dtype) for v in like]
    call = jax.ffi.ffi_call(target, results, vmap_method="broadcast_all")
    return call(*jax.tree.leaves(args), penalty=np.float64(PENALTY), **attributes)
