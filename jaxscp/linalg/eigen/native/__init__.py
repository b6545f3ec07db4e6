"""Eigenvalues and the projection in C++, as compiled for this machine.

In the order in which they build on each other (``libraries/pack.h`` has the registers):

    eigen.h       several symmetric matrices at once: their eigenvalues and vectors
    handler.cc    what XLA calls: its threads share the packs
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import libraries

LIBRARY = libraries.SEMIDEFINITE
NEAREST, EIGEN = LIBRARY.targets


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """``in_jax.nearest``, to rounding."""
    shapes = matrices.shape, matrices.shape[:1]
    results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    found, least = jax.ffi.ffi_call(NEAREST, results, vmap_method="broadcast_all")(matrices)
    return found, least


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """``in_jax.eigen``, to rounding and but for the order."""
    shapes = matrices.shape[:-1], matrices.shape
    results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    values, vectors = jax.ffi.ffi_call(EIGEN, results, vmap_method="broadcast_all")(matrices)
    return values, vectors
