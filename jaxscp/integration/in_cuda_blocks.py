"""Integration by a CUDA block an interval, for float64: with path outputs, and with derivatives up to the second.

In JAX, second derivatives are thousands of small operations, each of which reads and writes all intervals. In one
kernel, tangents and Hessian stay in registers and shared memory.
"""

from pathlib import Path
from typing import Any

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


def kernel(
    intervals: Intervals, tapes: IntervalTapes, inputs: int, order: int, capability: str
) -> launch.Kernel | None:
    """Compiled kernel; None and a warning if an interval does not fit in shared memory, or it does not compile.

    Args:
        intervals: the integration.
        tapes: its functions, recorded up to the order.
        inputs: size of w.
        order: highest derivative.
        capability: compute capability of the GPU.
    """
    source = interval_source.Source(intervals, tapes, inputs, order)
    threads = interval_source.threads(inputs, order)
    if threads > MOST_THREADS:
        warn_slow(
            f"an interval has {inputs} variables, too many for a CUDA kernel; JAX integrates it, and is slower"
        )
        return None
    if source.shared > (most := cuda.shared_memory(capability)):
        warn_slow(
            f"an interval of this problem needs {source.shared} bytes of a GPU's shared memory, of which a block has "
            f"{most}; JAX integrates it, and is slower"
        )
        return None
    folders = (Path(native.__file__).parent,)
    cubin = launch.cubin(source.text, capability, "the integration", folders)
    if cubin is None:
        return None
    return launch.Kernel(native.LIBRARY.on_gpu, cubin, threads, threads, shared=source.shared)


def integrate(
    intervals: Intervals,
    tapes: IntervalTapes,
    kernel: launch.Kernel,
    w: Float[Array, "intervals inputs"],
    data: IntervalData,
    multipliers: IntervalOutputs | None,
    order: int,
) -> tuple[Any, ...]:
    """As ``in_cpp.integrate``, by a kernel of the same order."""
    count, inputs = w.shape
    hoisted = [hoisted_constants(f) for f in (*tapes[:3], *tapes.margins)]
    weights = jnp.zeros((count, 0)) if multipliers is None else side_by_side(multipliers)
    shapes = [(count, *shape) for shape in flat_shapes(intervals, tapes, inputs)]
    unused = [(count, 0)] * (2 - order)
    found = kernel(
        w, jnp.concatenate(hoisted), side_by_side(data), weights, shapes=[*shapes[: order + 1], *unused]
    )
    return in_parts(intervals, tapes, found[: order + 1])
