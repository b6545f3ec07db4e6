"""CUDA kernels with any float64 arguments and results: compilation, and launch by a library's ``gpu_handler.cc``."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from jaxscp.backends import cuda, libraries


class Kernel(NamedTuple):
    """A compiled kernel and its launch parameters."""

    target: str
    """FFI target that launches it."""
    cubin: bytes
    """Machine code."""
    group_size: int
    """Threads that work on one element of a batch."""
    threads: int
    """Threads of a block."""
    axes: int = 1
    """Axes of an element in the first argument."""
    shared: int = 0
    """Bytes of a block's shared memory."""

    def __call__(self, *args: Array, shapes: Sequence[tuple[int, ...]]) -> Sequence[Array]:
        """Results of the given shapes.

        Args:
            args: arguments; leading axes are a batch.
            shapes: shapes of the results.
        """
        if not libraries.in_float64(args):
            raise TypeError(f"a kernel takes float64, got {', '.join(str(v.dtype) for v in args)}")
        results = [jax.ShapeDtypeStruct(shape, args[0].dtype) for shape in shapes]
        call = jax.ffi.ffi_call(self.target, results, vmap_method="broadcast_all")
        numbers = {
            name: np.int64(getattr(self, name)) for name in ("axes", "group_size", "threads", "shared")
        }
        carried = cuda.attributes(self.cubin)
        carried["name"] += f"/{self.shared}"  # a loaded kernel has one size of shared memory
        return call(*args, **numbers, **carried)


def available(library: libraries.Library) -> bool:
    """Whether kernels can be compiled, and launched by a library on the GPU that JAX runs on."""
    return cuda.launches(library) and cuda.compiler() is not None


@functools.cache
def cubin(
    text: str, capability: str, owner: str, folders: tuple[Path, ...] = (), **macros: object
) -> bytes | None:
    """``cuda.compile_cubin``, once for each kernel."""
    return cuda.compile_cubin(text, capability, owner, folders, **macros)
