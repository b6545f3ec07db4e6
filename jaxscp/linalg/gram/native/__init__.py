"""Gram matrices in C++, compiled for this machine, and in CUDA.

In the order in which the files build on each other (``backends/native/dense.h`` has the products):

    gram.h        sums at one location
    handler.cc    XLA FFI handler on a CPU
    gram.cu       the same by a warp; ``gpu.py`` compiles it for the sizes of the constraints
    gpu_handler.cc    XLA FFI handler that launches it
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.backends import libraries
from jaxscp.linalg.gram.system import GramSums, WeightedRows

LIBRARY = libraries.GRAM
(TARGET,) = LIBRARY.targets


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """``in_jax.gram``, equal to rounding."""
    locations, _, _, inputs = parts[0].jacobian.shape
    vectors = parts[0].vectors.shape[-1]
    arrays = []
    for p in parts:
        arrays += [p.jacobian, p.weight, p.vectors]
        arrays += [] if p.rank_one is None else [p.rank_one]
    shapes = (locations, inputs, inputs), (locations, vectors, inputs)
    call = jax.ffi.ffi_call(
        TARGET, [jax.ShapeDtypeStruct(s, jnp.float64) for s in shapes], vmap_method="broadcast_all"
    )
    rank_one = np.array([p.rank_one is not None for p in parts], np.int32)
    return GramSums(*call(*arrays, rank_one=rank_one))
