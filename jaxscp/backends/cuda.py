"""Kernels for NVIDIA GPUs: compiled when they are needed, for the GPUs of this process, by NVIDIA's run-time compiler.

That is in the extra ``cuda``; what launches a kernel is part of a library for CPUs (``driver.h``). Without either, and
on other GPUs, all runs as JAX.
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


def capability() -> str | None:
    """Compute capability of this process's GPUs, ``"90"`` say, if they have what kernels need and are alike."""
    if jax.default_backend() != "gpu":
        return None
    found = {getattr(device, "compute_capability", "") for device in jax.local_devices()}
    if len(found) != 1 or not all(part.isdecimal() for part in min(found).split(".")):
        return None
    number = tuple(map(int, min(found).split(".")))
    return "".join(map(str, number)) if number >= OLDEST else None


def launches(library: libraries.Library) -> bool:
    """Whether JAX runs on GPUs for kernels, and what launches a library's was compiled; makes that known to XLA."""
    return (
        library.on_gpu != ""
        and capability() is not None
        and libraries.level(library.stem, library.on_gpu, "CUDA") is not None
    )


@functools.cache
def compiler() -> Any:
    """NVIDIA's run-time compiler, if it is installed."""
    try:
        nvrtc = importlib.import_module("cuda.bindings.nvrtc")
        nvrtc.nvrtcVersion()
    except (ImportError, RuntimeError, OSError):
        return None
    return nvrtc


def machine_code(
    source: str, capability: str, whose: str, folders: Sequence[Path] = (), **macros: object
) -> bytes | None:
    """A kernel as machine code of the GPU; None and a warning if it does not compile.

    Args:
        source: its text.
        capability: of the GPU.
        whose: the kernel is, for the warning.
        folders: where headers are.
        macros: to be defined.
    """
    nvrtc = compiler()
    options = [
        f"--gpu-architecture=sm_{capability}",
        "--std=c++20",
        "--device-as-default-execution-space",
        *(f"--include-path={folder}" for folder in folders),
        *(f"-D{name}={value}" for name, value in macros.items()),
    ]

    def checked(result: Any, *values: Any) -> Any:
        if int(result) != 0:
            raise RuntimeError(f"NVIDIA's compiler: {result}")
        return values[0] if values else None

    program = checked(*nvrtc.nvrtcCreateProgram(source.encode(), b"kernel.cu", 0, [], []))
    try:
        (result,) = nvrtc.nvrtcCompileProgram(program, len(options), [option.encode() for option in options])
        if int(result) != 0:
            log = bytearray(checked(*nvrtc.nvrtcGetProgramLogSize(program)))
            checked(*nvrtc.nvrtcGetProgramLog(program, log))
            said = log.decode(errors="replace").strip("\0\n ")
            message = f"jaxscp: {whose}'s kernel does not compile, and it runs as JAX ({result}: {said})"
            warnings.warn(message, stacklevel=3)
            return None
        image = bytearray(checked(*nvrtc.nvrtcGetCUBINSize(program)))
        checked(*nvrtc.nvrtcGetCUBIN(program, image))
    finally:
        checked(*nvrtc.nvrtcDestroyProgram(program))
    return bytes(image)


def attributes(image: bytes) -> dict:
    """What a call carries with it for a kernel's sake."""
    return {"image": np.frombuffer(image, np.uint8), "name": hashlib.sha256(image).hexdigest()}
