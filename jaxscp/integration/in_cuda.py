"""The pass as one kernel of an NVIDIA GPU, for float64 and intervals of which only the end is asked.

As JAX plays a tape, every stage of every step is several kernels that read and write all tangents. Here they stay with
the threads from an interval's begin to its end.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import launch
from jaxscp.integration.intervals import IntervalOutputs, Intervals
from jaxscp.integration.native import cuda_source
from jaxscp.integration.rate_tape import record_slopes

COLUMNS = 2  # of the tangent, that a thread carries


class Kernel(NamedTuple):
    """One, and what it is told."""

    text: str
    groups: int
    """Threads of an interval."""
    known: Float[Array, "numbers"]
    """What depends on no interval's variables, and is read there."""


def serves(intervals: Intervals, w: Array) -> bool:
    """Whether there may be a kernel for these intervals, on the GPU that is JAX's default device."""
    return libraries.in_float64(w) and launch.available() and intervals.watch.nothing


def record(intervals: Intervals, inputs: int, columns: int = COLUMNS) -> Kernel:
    """The kernel for intervals of so many inputs, of which a thread has so many columns.

    Raises:
        CannotTrace: if the slopes are not arithmetic alone.
    """
    slopes = record_slopes(intervals, inputs, order=1)
    text = cuda_source.kernel(slopes, intervals.states, intervals.method, intervals.steps, columns)
    return Kernel(text, cuda_source.groups(inputs, columns), launch.known_of(slopes))


def sweep(
    intervals: Intervals, kernel: Kernel, machine_code: bytes, w: Float[Array, "intervals inputs"]
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """The outcomes and their Jacobian, by a kernel for these intervals."""
    count, inputs = w.shape
    n = intervals.states
    shapes = (count, n + 1), (count, n + 1, inputs)
    end, jacobian = launch.call(machine_code, w, kernel.known, shapes, kernel.groups, cuda_source.THREADS)
    return (
        IntervalOutputs(end[:, :n], end[:, n], (), jnp.zeros((count, 0))),
        IntervalOutputs(jacobian[:, :n], jacobian[:, n], (), jnp.zeros((count, 0, inputs))),
    )
