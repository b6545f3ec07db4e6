"""Integration by one CUDA kernel, for float64 and intervals without path outputs.

In JAX, every stage of every step is several kernels that read and write all tangents. In one kernel, tangents stay in
registers from an interval's begin to its end.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import launch, libraries
from jaxscp.backends.codegen.hoisted import hoisted_constants
from jaxscp.integration import native
from jaxscp.integration.intervals import IntervalOutputs, Intervals
from jaxscp.integration.native import cuda_source
from jaxscp.integration.rate_tape import record_rate

COLUMNS = 2  # columns of the tangent in a thread's registers


class Source(NamedTuple):
    """A kernel's text, and the numbers that go with it."""

    text: str
    group_size: int
    """Threads of an interval."""
    hoisted: Float[Array, "hoisted"]
    """Constants that depend on no interval's variables."""


def supports(intervals: Intervals, w: Array) -> bool:
    """Whether a kernel can integrate these intervals on the GPU that is JAX's default device."""
    return libraries.in_float64(w) and launch.available(native.LIBRARY) and intervals.path_outputs.empty


def record(intervals: Intervals, inputs: int, columns: int = COLUMNS) -> Source:
    """Kernel for intervals of one shape.

    Args:
        intervals: the integration.
        inputs: size of w.
        columns: columns of the tangent in a thread's registers.

    Raises:
        CannotTrace: if the rate is not arithmetic alone.
    """
    rate = record_rate(intervals, inputs, order=1)
    text = cuda_source.kernel(rate, intervals.states, intervals.method, intervals.steps, columns)
    return Source(text, cuda_source.group_size(inputs, columns), hoisted_constants(rate))


def linearise(
    intervals: Intervals, source: Source, cubin: bytes, w: Float[Array, "intervals inputs"]
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outputs and their Jacobian, by a kernel for these intervals."""
    count, inputs = w.shape
    n = intervals.states
    shapes = (count, n + 1), (count, n + 1, inputs)
    kernel = launch.Kernel(native.LIBRARY.on_gpu, cubin, source.group_size, cuda_source.THREADS)
    end, jacobian = kernel(w, source.hoisted, shapes=shapes)
    return (
        IntervalOutputs(end[:, :n], end[:, n], (), jnp.zeros((count, 0))),
        IntervalOutputs(jacobian[:, :n], jacobian[:, n], (), jnp.zeros((count, 0, inputs))),
    )
