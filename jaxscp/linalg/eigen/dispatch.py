"""Eigenvalues and nearest semidefinite matrices for float64: in C++ on a CPU if compiled, in a kernel on an NVIDIA GPU;
else in JAX.

LAPACK takes one small matrix after another, and spends most of the time outside of the arithmetic. The C++ takes one
matrix in each lane of a register, the kernel one in each warp.
"""

from jaxtyping import Array, Float

from jaxscp.backends.libraries import dispatch, in_float64
from jaxscp.linalg.eigen import in_jax, native
from jaxscp.linalg.eigen.native import gpu


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """Nearest positive semidefinite matrix to each symmetric matrix, and the lowest eigenvalue of the latter.

    Results are NaN for a matrix with entries that are not finite, and for no other.
    """
    cpu = native.nearest if _compiled(matrices) else None
    return dispatch(cpu, in_jax.nearest, matrices, cuda=gpu.nearest if gpu.supports(matrices) else None)


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """Eigenvalues of symmetric matrices, in any order, and eigenvectors as columns. Not differentiable.

    Results are NaN for a matrix with entries that are not finite, and for no other.
    """
    cpu = native.eigen if _compiled(matrices) else None
    return dispatch(
        cpu, in_jax.eigen, matrices, cuda=gpu.eigen if gpu.supports(matrices, nearest=False) else None
    )


def _compiled(matrices: Array) -> bool:
    return in_float64(matrices) and native.LIBRARY.available()
