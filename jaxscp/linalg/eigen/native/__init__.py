"""Eigenvalues and nearest semidefinite matrices in C++, compiled for this machine, and in CUDA.

In the order in which the files build on each other (``backends/native/pack.h`` has the registers):

    eigen.h       eigenvalues and vectors of several symmetric matrices at once
    handler.cc    XLA FFI handlers on a CPU
    eigen.cu      the same, one matrix by each warp; ``gpu.py`` compiles it for the size of a matrix
    gpu_handler.cc    XLA FFI handler that launches it
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import libraries

LIBRARY = libraries.EIGEN
NEAREST, EIGEN = LIBRARY.targets


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """``in_jax.nearest``, equal to rounding."""
    shapes = matrices.shape, matrices.shape[:1]
    results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    found, least = jax.ffi.ffi_call(NEAREST, results, vmap_method="broadcast_all")(matrices)
    return found, least


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """``in_jax.eigen``, equal to rounding, in another order."""
    shapes = matrices.shape[:-1], matrices.shape
    results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    values, vectors = jax.ffi.ffi_call(EIGEN, results, vmap_method="broadcast_all")(matrices)
    return values, vectors
