"""The sums in C++, as compiled for this machine.

In the order in which they build on each other (products are those of ``libraries/dense.h``):

    normal.h      one place
    handler.cc    what XLA calls: its threads share the places
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.backends import libraries
from jaxscp.linalg.gram.system import GramSums, WeightedRows

LIBRARY = libraries.NORMAL
(TARGET,) = LIBRARY.targets


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """``in_jax.gram``, to rounding."""
    places, _, _, inputs = parts[0].jacobian.shape
    sides = parts[0].sides.shape[-1]
    arrays = []
    for p in parts:
        arrays += (
            [p.jacobian, p.weight, p.sides] if p.along is None else [p.jacobian, p.weight, p.sides, p.along]
        )
    shapes = (places, inputs, inputs), (places, sides, inputs)
    call = jax.ffi.ffi_call(
        TARGET, [jax.ShapeDtypeStruct(s, jnp.float64) for s in shapes], vmap_method="broadcast_all"
    )
    coupled = np.array([p.along is not None for p in parts], np.int32)
    return GramSums(*call(*arrays, coupled=coupled))
