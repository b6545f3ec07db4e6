"""Eigenvalues and the projection, on a CPU in float64 by C++ if that was compiled, and else as JAX.

LAPACK takes one small matrix after another, and most of its time for what it does around the arithmetic; C++ takes
as many at once as a register has places.
"""

from jaxtyping import Array, Float

from jaxscp.backends.libraries import choose, in_float64
from jaxscp.linalg.eigen import in_jax, native


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """What is nearest to each symmetric matrix among those without negative eigenvalues, and the lowest eigenvalue that
    it had. All is NaN of a matrix with entries that are not finite, and of that alone."""
    cpu = native.nearest if in_float64(matrices) and native.LIBRARY.available() else None
    return choose(cpu, in_jax.nearest, matrices)


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """Eigenvalues of symmetric matrices, in any order, and their vectors, which are columns; without derivative. All is
    NaN of a matrix with entries that are not finite, and of that alone."""
    cpu = native.eigen if in_float64(matrices) and native.LIBRARY.available() else None
    return choose(cpu, in_jax.eigen, matrices)
