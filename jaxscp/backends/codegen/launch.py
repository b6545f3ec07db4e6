"""Kernels for NVIDIA GPUs that are written from tapes: compiled, told what is known, and launched."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import cuda_text, evaluate_tape
from jaxscp.backends.codegen.functions import Function

TARGET = libraries.SWEEP.on_gpu


def available() -> bool:
    """Whether they can be compiled, and launched on the GPU that JAX runs on."""
    return cuda.launches(libraries.SWEEP) and cuda.compiler() is not None


@functools.cache
def image(text: str, capability: str, whose: str) -> bytes | None:
    """A kernel as machine code of the GPU; None and a warning if it does not compile."""
    return cuda.machine_code(text, capability, whose)


def known_of(slopes: Function) -> Float[Array, "numbers"]:
    """What a kernel reads of a flight, in its order."""
    places = cuda_text.known(slopes)
    hoisted_tape = slopes.first._replace(
        operations=slopes.first.operations[: slopes.first.hoisted], outputs=np.array(places, int)
    )
    nothing = [jnp.zeros(())] * (slopes.arguments + slopes.values)  # is read of the arguments
    found = evaluate_tape.play(hoisted_tape, nothing, slopes.parameters[0])
    return jnp.stack(found) if found else jnp.zeros(0)


def call(
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
    launch = jax.ffi.ffi_call(TARGET, results, vmap_method="broadcast_all")
    numbers = {"groups": np.int64(together), "threads": np.int64(threads)}
    return launch(w, known, **numbers, **cuda.attributes(machine_code))
