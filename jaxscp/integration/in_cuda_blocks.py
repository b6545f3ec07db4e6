"""Integration by two CUDA kernels, for float64: with path outputs, and with derivatives up to the second.

In JAX, second derivatives are thousands of small operations, each of which reads and writes all intervals. Here one
kernel integrates an interval by a thread: its steps follow each other. Another one finds the derivatives by a block,
a column a thread; tangents and Hessian stay in registers and shared memory.
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import cuda, launch, libraries
from jaxscp.backends.codegen.hoisted import hoisted_constants
from jaxscp.backends.serving import warn_slow
from jaxscp.integration import native
from jaxscp.integration.interval_tapes import IntervalTapes, flat_shapes, in_parts, side_by_side
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals
from jaxscp.integration.native import interval_source

MOST_THREADS = 1024  # of a block


def supports(w: Array) -> bool:
    """Whether a kernel can integrate intervals of these variables on the GPU that is JAX's default device."""
    return libraries.in_float64(w) and launch.available(native.LIBRARY)


class Kernels(NamedTuple):
    """The kernels of an integration."""

    paths: launch.Kernel
    """Integrates an interval by one thread."""
    stored: int
    """Numbers that it stores of each interval for the other kernel; intervals alternate in the array."""
    stored_of_slopes: int
    """Numbers of the slopes' derivatives that it stores, interval after interval."""
    columns: launch.Kernel | None
    """Finds derivatives from these, by a block an interval; None at order zero."""


def kernels(
    intervals: Intervals, tapes: IntervalTapes, inputs: int, order: int, capability: str
) -> Kernels | None:
    """Compiled kernels; None and a warning if an interval does not fit in shared memory, or one does not compile.

    Args:
        intervals: the integration.
        tapes: its functions, recorded up to the order.
        inputs: size of w.
        order: highest derivative.
        capability: compute capability of the GPU.
    """
    source = interval_source.Source(intervals, tapes, inputs, order)
    threads = interval_source.threads(inputs)
    most = cuda.shared_memory(capability)
    if order and threads > MOST_THREADS:
        warn_slow(
            f"an interval has {inputs} variables, too many for a CUDA kernel; JAX integrates it, and is slower"
        )
        return None
    shared = max(source.shared, source.shared_by_paths)
    if order and shared > most:
        warn_slow(
            f"an interval of this problem needs {shared} bytes of a GPU's shared memory, of which a block has "
            f"{most}; JAX integrates it, and is slower"
        )
        return None
    texts = [source.paths, source.columns][: 1 + (order > 0)]
    blocks = cuda.blocks(capability, source.shared, threads)
    with ThreadPoolExecutor() as pool:  # compilation takes long, and does not hold Python's lock
        cubins = [c for c in pool.map(lambda text: _cubin(text, capability, blocks), texts) if c is not None]
    if len(cubins) < len(texts):
        return None
    on_gpu, group = native.LIBRARY.on_gpu, interval_source.PATH_THREADS
    paths, *columns = cubins
    return Kernels(
        launch.Kernel(on_gpu, paths, 1, group, shared=source.shared_by_paths),
        source.stored,
        source.stored_of_slopes,
        launch.Kernel(on_gpu, columns[0], threads, threads, shared=source.shared) if columns else None,
    )


def _cubin(text: str, capability: str, blocks: int) -> bytes | None:
    return launch.cubin(
        text,
        capability,
        "the integration",
        (Path(native.__file__).parent, libraries.HEADERS),
        JAXSCP_BLOCKS=blocks,
    )


def integrate(
    intervals: Intervals,
    tapes: IntervalTapes,
    kernels: Kernels,
    w: Float[Array, "intervals inputs"],
    data: IntervalData,
    multipliers: IntervalOutputs | None,
    order: int,
) -> tuple[Any, ...]:
    """As ``in_cpp.integrate``, by kernels of the same order."""
    count, inputs = w.shape
    hoisted = jnp.concatenate([hoisted_constants(f) for f in (*tapes[:3], *tapes.margins)])
    weights = jnp.zeros((count, 0)) if multipliers is None else side_by_side(multipliers)
    shapes = [(count, *shape) for shape in flat_shapes(intervals, tapes, inputs)]
    group = interval_source.PATH_THREADS
    stored = [(-(-count // group) * group, kernels.stored), (count, kernels.stored_of_slopes)]
    outputs, of_intervals, of_slopes = kernels.paths(
        w, hoisted, side_by_side(data), weights, shapes=[shapes[0], *stored]
    )
    derivatives = []
    if kernels.columns is not None:
        unused = [(count, 0)] * (2 - order)
        derivatives = kernels.columns(of_slopes, of_intervals, shapes=[*shapes[1 : order + 1], *unused])
    return in_parts(intervals, tapes, [outputs, *derivatives[:order]])
