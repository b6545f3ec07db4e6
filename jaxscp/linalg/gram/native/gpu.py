"""Gram matrices on an NVIDIA GPU: a warp a location, compiled for the constraints' sizes on first use."""

from pathlib import Path

import jax

from jaxscp.backends import cuda, launch, libraries
from jaxscp.linalg.gram.system import GramSums, WeightedRows

LIBRARY = libraries.GRAM
FOLDER = Path(__file__).parent
WARP, THREADS = 32, 128
MOST_INPUTS = 48  # whose sums fit in a thread's registers
MOST_VECTORS = 8  # columns of a tile


def supports(parts: tuple[WeightedRows, ...]) -> bool:
    """Whether a kernel can serve constraints of these sizes on the GPU that is JAX's default device."""
    return (
        libraries.in_float64(parts)
        and parts[0].jacobian.shape[-1] <= MOST_INPUTS
        and parts[0].vectors.shape[-1] <= MOST_VECTORS
        and launch.available(LIBRARY)
        and _kernel(parts) is not None
    )


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """``in_jax.gram``, equal to rounding."""
    kernel = _kernel(parts)
    if kernel is None:
        raise RuntimeError("jaxscp: no GPU here that the kernel of Gram matrices runs on")
    locations, _, _, inputs = parts[0].jacobian.shape
    shapes = (locations, inputs, inputs), (locations, parts[0].vectors.shape[-1], inputs)
    return GramSums(*kernel(*(v for p in parts for v in _arrays(p)), shapes=shapes))


def _arrays(part: WeightedRows) -> tuple[jax.Array, ...]:
    """Arrays of a constraint; the last one is not read if the weight matrix is diagonal."""
    return part.jacobian, part.weight, part.vectors, part.weight if part.rank_one is None else part.rank_one


def _kernel(parts: tuple[WeightedRows, ...]) -> launch.Kernel | None:
    """None if it does not compile."""
    capability = cuda.capability()
    if capability is None:
        return None
    names = [f"a{i}" for i in range(4 * len(parts))]
    macros = {
        "JAXSCP_POINTS": _list(p.jacobian.shape[1] for p in parts),
        "JAXSCP_ROWS": _list(p.jacobian.shape[2] for p in parts),
        "JAXSCP_RANK_ONE": _list(int(p.rank_one is not None) for p in parts),
        "JAXSCP_INPUTS": parts[0].jacobian.shape[-1],
        "JAXSCP_VECTORS": parts[0].vectors.shape[-1],
        "JAXSCP_PARAMETERS": _list(f"const double* __restrict__ {name}" for name in names),
        "JAXSCP_ARGUMENTS": _list(names),
        "JAXSCP_THREADS": THREADS,
    }
    text = (FOLDER / "gram.cu").read_text()
    cubin = launch.cubin(text, capability, "the Gram matrices", (libraries.HEADERS,), **macros)
    return None if cubin is None else launch.Kernel(LIBRARY.on_gpu, cubin, WARP, THREADS, axes=3)


def _list(items) -> str:
    return ", ".join(map(str, items))
