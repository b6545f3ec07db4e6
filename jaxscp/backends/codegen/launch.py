"""CUDA kernels that are written from tapes: compilation, hoisted constants, and the launch."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import cuda_text, evaluate_tape
from jaxscp.backends.codegen.functions import TapedFunction

TARGET = libraries.INTEGRATION.on_gpu


def available() -> bool:
    """Whether kernels can be compiled, and launched on the GPU that JAX runs on."""
    return cuda.launches(libraries.INTEGRATION) and cuda.compiler() is not None


@functools.cache
def cubin(text: str, capability: str, owner: str) -> bytes | None:
    """Cubin of a kernel; None and a warning if compilation fails."""
    return cuda.compile_cubin(text, capability, owner)


def hoisted_constants(function: TapedFunction) -> Float[Array, "hoisted"]:
    """Values that depend on no argument, in the order in which a kernel reads them."""
    slots = cuda_text.hoisted_slots(function)
    hoisted_tape = function.first._replace(
        operations=function.first.operations[: function.first.hoisted_count], outputs=np.array(slots, int)
    )
    unread = [jnp.zeros(())] * function.inputs  # no hoisted operation reads an input
    found = evaluate_tape.evaluate(hoisted_tape, unread, function.parameters[0])
    return jnp.stack(found) if found else jnp.zeros(0)


def call(
    cubin: bytes,
    w: Float[Array, "batch inputs"],
    hoisted: Float[Array, "hoisted"],
    shapes: tuple[tuple[int, ...], tuple[int, ...]],
    group_size: int,
    threads: int,
) -> Sequence[Array]:
    """Two arrays, which a kernel computes from a batch.

    Args:
        cubin: machine code of the kernel.
        w: inputs, one row for each element of the batch.
        hoisted: constants shared by the batch.
        shapes: shapes of the two arrays.
        group_size: threads that work on one element.
        threads: threads of a block.
    """
    results = [jax.ShapeDtypeStruct(shape, w.dtype) for shape in shapes]
    launch = jax.ffi.ffi_call(TARGET, results, vmap_method="broadcast_all")
    numbers = {"group_size": np.int64(group_size), "threads": np.int64(threads)}
    return launch(w, hoisted, **numbers, **cuda.attributes(cubin))
