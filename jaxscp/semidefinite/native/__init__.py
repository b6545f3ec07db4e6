"""The projection in C++, as compiled for this machine.

In the order in which they build on each other (``libraries/pack.h`` has the registers):

    eigen.h       several symmetric matrices at once: their eigenvalues and vectors
    handler.cc    what XLA calls: its threads share the packs
"""

from pathlib import Path

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import libraries

TARGET = "jaxscp_nearest_semidefinite"
TARGETS = (TARGET,)
STEM = Path(__file__).with_name("semidefinite")


def available() -> bool:
    """Whether it was compiled for this machine; makes it known to XLA."""
    return level() is not None


def level() -> str | None:
    """The instruction set that it is compiled for here, if it is; see ``libraries.LEVELS``."""
    return libraries.level(STEM, TARGET)


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """``in_jax.nearest``, to rounding."""
    shapes = matrices.shape, matrices.shape[:1]
    results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    found, least = jax.ffi.ffi_call(TARGET, results, vmap_method="broadcast_all")(matrices)
    return found, least
