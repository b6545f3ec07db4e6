"""Eigenvalues on an NVIDIA GPU: a warp a matrix, compiled for the size of the matrices on first use."""

from pathlib import Path

import jax
from jaxtyping import Array, Float

from jaxscp.backends import cuda, launch, libraries

LIBRARY = libraries.EIGEN
FOLDER = Path(__file__).parent
WARP = 32  # threads, each of which has a row


def supports(matrices: jax.Array, *, nearest: bool = True) -> bool:
    """Whether the kernel can serve matrices of this size on the GPU that is JAX's default device.

    Args:
        matrices: of the size.
        nearest: True for the kernel of ``nearest``, False for that of ``eigen``.
    """
    return (
        libraries.in_float64(matrices)
        and 0 < matrices.shape[-1] <= WARP
        and launch.available(LIBRARY)
        and _kernel(matrices.shape[-1], nearest=nearest) is not None
    )


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """``in_jax.nearest``, equal to rounding."""
    found, least = _call(matrices, matrices.shape, matrices.shape[:1], nearest=True)
    return found, least


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """``in_jax.eigen``, equal to rounding, in another order."""
    values, vectors = _call(matrices, matrices.shape[:-1], matrices.shape, nearest=False)
    return values, vectors


def _call(matrices: Array, *shapes: tuple[int, ...], nearest: bool):
    kernel = _kernel(matrices.shape[-1], nearest=nearest)
    if kernel is None:
        raise RuntimeError("jaxscp: no GPU here that the kernel of eigenvalues runs on")
    return kernel(matrices, shapes=shapes)


def _kernel(size: int, *, nearest: bool) -> launch.Kernel | None:
    """None if it does not compile."""
    capability = cuda.capability()
    if capability is None:
        return None
    macros: dict[str, object] = {"JAXSCP_SIZE": size, "JAXSCP_NEAREST": int(nearest)}
    cubin = launch.cubin((FOLDER / "eigen.cu").read_text(), capability, "the eigenvalues", **macros)
    return None if cubin is None else launch.Kernel(LIBRARY.on_gpu, cubin, WARP, WARP, axes=2)
