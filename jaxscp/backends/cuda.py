"""CUDA kernels, compiled at run time for the GPUs of this process by NVIDIA's compiler (NVRTC).

NVRTC is in the extra ``cuda``. The C++ that launches kernels (``driver.h``) is part of the compiled libraries. Without
either, and on other GPUs, JAX's own implementation runs.
"""

import functools
import hashlib
import importlib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxscp.backends import libraries

OLDEST = (8, 0)  # compute capability: the first whose tensor cores add float64
RESERVED = 1024  # bytes of a block's shared memory that CUDA takes
MOST_BLOCKS = 8  # that share a multiprocessor
REGISTERS_OF_MULTIPROCESSOR, REGISTERS = 65_536, 168  # all, and those that let a thread hold some 80 numbers


def capability() -> str | None:
    """Compute capability of this process's GPUs, such as ``"90"``.

    None if there is no GPU, if GPUs differ, or if they are older than ``OLDEST``.
    """
    if jax.default_backend() != "gpu":
        return None
    found = {getattr(device, "compute_capability", "") for device in jax.local_devices()}
    if len(found) != 1 or not all(part.isdecimal() for part in min(found).split(".")):
        return None
    number = tuple(map(int, min(found).split(".")))
    return "".join(map(str, number)) if number >= OLDEST else None


def shared_memory(capability: str) -> int:
    """Bytes of shared memory that a block can have (CUDA C++ Programming Guide, "Technical Specifications")."""
    kibibytes = {"80": 163, "87": 163, "90": 227, "100": 227, "103": 227}
    return 1024 * kibibytes.get(capability, 99)


def shared_memory_of_multiprocessor(capability: str) -> int:
    """Bytes of shared memory of a multiprocessor, which its blocks and CUDA share."""
    return shared_memory(capability) + RESERVED


def blocks(capability: str, shared: int, threads: int) -> int:
    """Blocks that a multiprocessor should run at once, at least one and at most ``MOST_BLOCKS``.

    Args:
        capability: compute capability of the GPU.
        shared: bytes of shared memory of a block.
        threads: threads of a block, each with ``REGISTERS`` or more.
    """
    by_memory = shared_memory_of_multiprocessor(capability) // (shared + RESERVED)
    return max(1, min(MOST_BLOCKS, by_memory, REGISTERS_OF_MULTIPROCESSOR // (REGISTERS * threads)))


def launches(library: libraries.Library) -> bool:
    """Whether a library can launch its kernel on JAX's GPUs; registers the launcher with XLA."""
    return (
        library.on_gpu != ""
        and capability() is not None
        and libraries.level(library.stem, library.on_gpu, "CUDA") is not None
    )


@functools.cache
def compiler() -> Any:
    """NVRTC's Python module; None if it is not installed."""
    try:
        nvrtc = importlib.import_module("cuda.bindings.nvrtc")
        nvrtc.nvrtcVersion()
    except (ImportError, RuntimeError, OSError):
        return None
    return nvrtc


def compile_cubin(
    source: str, capability: str, owner: str, folders: Sequence[Path] = (), **macros: object
) -> bytes | None:
    """Cubin (a GPU's machine code) of a kernel; None and a warning if compilation fails.

    Args:
        source: CUDA text.
        capability: compute capability of the GPU.
        owner: algorithm that the kernel belongs to, for the warning.
        folders: folders of headers.
        macros: preprocessor definitions.
    """
    nvrtc = compiler()
    options = [
        f"--gpu-architecture=sm_{capability}",
        "--std=c++20",
        "--device-as-default-execution-space",
        *(f"--include-path={folder}" for folder in folders),
        *(f"-D{name}={value}" for name, value in macros.items()),
    ]
    program = _checked(*nvrtc.nvrtcCreateProgram(source.encode(), b"kernel.cu", 0, [], []))
    try:
        (result,) = nvrtc.nvrtcCompileProgram(program, len(options), [option.encode() for option in options])
        if int(result) != 0:
            log = bytearray(_checked(*nvrtc.nvrtcGetProgramLogSize(program)))
            _checked(*nvrtc.nvrtcGetProgramLog(program, log))
            errors = log.decode(errors="replace").strip("\0\n ")
            message = f"jaxscp: {owner}'s kernel does not compile, and it runs as JAX ({result}: {errors})"
            warnings.warn(message, stacklevel=3)
            return None
        cubin = bytearray(_checked(*nvrtc.nvrtcGetCUBINSize(program)))
        _checked(*nvrtc.nvrtcGetCUBIN(program, cubin))
    finally:
        _checked(*nvrtc.nvrtcDestroyProgram(program))
    return bytes(cubin)


def attributes(cubin: bytes) -> dict:
    """XLA FFI attributes that carry a kernel: the cubin, and its hash as name."""
    return {"cubin": np.frombuffer(cubin, np.uint8), "name": hashlib.sha256(cubin).hexdigest()}


def _checked(result: Any, *values: Any) -> Any:
    if int(result) != 0:
        raise RuntimeError(f"NVIDIA's compiler: {result}")
    return values[0] if values else None
