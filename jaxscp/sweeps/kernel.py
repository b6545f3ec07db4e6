"""The pass as one kernel of an NVIDIA GPU, for float64 and intervals of which only the end is asked.

As JAX plays a tape, every stage of every step is several kernels that read and write all tangents. Here they stay with
the threads from an interval's begin to its end.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp import libraries
from jaxscp.libraries import cuda
from jaxscp.sweeps import functions, played
from jaxscp.sweeps.functions import Function
from jaxscp.sweeps.intervals import Intervals, Outcome
from jaxscp.sweeps.native import source, statements

TARGET = libraries.SWEEP.on_gpu
COLUMNS = 2  # of the tangent, that a thread carries


class Kernel(NamedTuple):
    """One, and what it is told."""

    text: str
    groups: int
    """Threads of an interval."""
    known: Float[Array, "numbers"]
    """What depends on no interval's variables, and is read there."""


def kernels() -> bool:
    """Whether kernels that are written from tapes can be compiled, and launched on the GPU that JAX runs on."""
    return cuda.launches(libraries.SWEEP) and cuda.compiler() is not None


def serves(intervals: Intervals, w: Array) -> bool:
    """Whether there may be a kernel for these intervals, on the GPU that is JAX's default device."""
    return libraries.in_float64(w) and kernels() and intervals.watch.nothing


def record(intervals: Intervals, inputs: int, columns: int = COLUMNS) -> Kernel:
    """The kernel for intervals of so many inputs, of which a thread has so many columns.

    Raises:
        CannotTrace: if the slopes are not arithmetic alone.
    """
    slopes = functions.record_slopes(intervals, inputs, order=1)
    text = source.kernel(slopes, intervals.states, intervals.method, intervals.steps, columns)
    return Kernel(text, source.groups(inputs, columns), known_of(slopes))


def known_of(slopes: Function) -> Float[Array, "numbers"]:
    """What a kernel reads of a flight, in its order."""
    places = statements.known(slopes)
    once = slopes.first._replace(
        operations=slopes.first.operations[: slopes.first.once], outputs=np.array(places, int)
    )
    nothing = [jnp.zeros(())] * (slopes.arguments + slopes.values)  # is read of the arguments
    found = played.play(once, nothing, slopes.parameters[0])
    return jnp.stack(found) if found else jnp.zeros(0)


@functools.cache
def image(text: str, capability: str, whose: str = "the sweep") -> bytes | None:
    """A kernel as machine code of the GPU; None and a warning if it does not compile."""
    return cuda.machine_code(text, capability, whose)


def sweep(
    intervals: Intervals, kernel: Kernel, machine_code: bytes, w: Float[Array, "intervals inputs"]
) -> tuple[Outcome, Outcome]:
    """The outcomes and their Jacobian, by a kernel for these intervals."""
    count, inputs = w.shape
    n = intervals.states
    shapes = (count, n + 1), (count, n + 1, inputs)
    end, jacobian = launched(machine_code, w, kernel.known, shapes, kernel.groups, source.THREADS)
    return (
        Outcome(end[:, :n], end[:, n], (), jnp.zeros((count, 0))),
        Outcome(jacobian[:, :n], jacobian[:, n], (), jnp.zeros((count, 0, inputs))),
    )


def launched(
    machine_code: bytes,
    w: Float[Array, "many inputs"],
    known: Float[Array, "numbers"],
    shapes: tuple[tuple[int, ...], tuple[int, ...]],
    together: int,
    threads: int,
) -> Sequence[Array]:
    """Two arrays of these shapes, which a kernel makes of what a flight has many of and of what is known of it.

    So many threads work on one of the many together, and so many are a block.
    """
    results = [jax.ShapeDtypeStruct(shape, w.dtype) for shape in shapes]
    call = jax.ffi.ffi_call(TARGET, results, vmap_method="broadcast_all")
    numbers = {"groups": np.int64(together), "threads": np.int64(threads)}
    return call(w, known, **numbers, **cuda.attributes(machine_code))
