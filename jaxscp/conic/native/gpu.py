"""The kernel of the interior point for NVIDIA GPUs: ``kernel.cu``, compiled for a program's sizes when it is needed.

NVIDIA's run-time compiler, in the extra ``cuda``, makes it from the same headers as the loop for CPUs; what launches it
is compiled with that loop. Without either, and on other GPUs, the interior point runs as JAX.
"""

import functools
import hashlib
import importlib
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxscp import libraries
from jaxscp.conic.program import StagedProgram

TARGET = libraries.ON_GPU
OLDEST = (8, 0)  # compute capability: the first whose tensor cores add float64
THREADS = 256  # that solve a program together
BLOCKS = 4  # programs that a multiprocessor has at once
WARP = 32


class Sizes(NamedTuple):
    """Those of a program, in the order of ``layout.h``."""

    nodes: int
    variables: int
    link_rows: int
    rows: int
    has_norm: bool
    cones: tuple[tuple[int, int], ...]
    """(number, dimension) of each group at a node."""

    def __str__(self) -> str:
        groups = ",".join(f"{{{count},{dimension}}}" for count, dimension in self.cones)
        numbers = [*self[:4], str(self.has_norm).lower(), len(self.cones)]
        return ",".join(map(str, numbers)) + f",{{{groups}}}"

    @property
    def fit(self) -> bool:
        """Whether a warp can eliminate the nodes and links: a lane for each row that is eliminated."""
        return max(self.variables, self.link_rows) <= WARP


def sizes_of(program: StagedProgram) -> Sizes:
    """Sizes of a program."""
    links, rows = program.links.soft.shape[1], program.rows.offset.shape[1]
    cones = tuple((c.offset.shape[1], c.offset.shape[2]) for c in program.cones)
    return Sizes(program.nodes, program.variables, links, rows, program.norm is not None, cones)


def serves(program: StagedProgram) -> bool:
    """Whether there is a kernel for this program, on the GPUs that JAX runs on; made if need be."""
    return _kernel(program) is not None


def capability() -> str | None:
    """Compute capability of this process's GPUs, ``"90"`` say, if they have what the kernel needs and are alike."""
    if jax.default_backend() != "gpu":
        return None
    found = {getattr(device, "compute_capability", "") for device in jax.local_devices()}
    if len(found) != 1 or not all(part.isdecimal() for part in min(found).split(".")):
        return None
    number = tuple(map(int, min(found).split(".")))
    return "".join(map(str, number)) if number >= OLDEST else None


def available() -> bool:
    """Whether JAX runs on GPUs for the kernel, and what launches it was compiled; makes that known to XLA."""
    return (
        capability() is not None
        and libraries.level(libraries.INTERIOR_POINT.stem, TARGET, "CUDA") is not None
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


def _kernel(program: StagedProgram) -> bytes | None:
    here, sizes = capability(), sizes_of(program)
    return kernel(sizes, here, THREADS, BLOCKS) if here and compiler() and sizes.fit else None


@functools.cache
def kernel(sizes: Sizes, capability: str, threads: int, blocks: int) -> bytes | None:
    """The kernel for programs of these sizes, as machine code of the GPU; None and a warning if it does not compile."""
    nvrtc = compiler()
    folder = Path(__file__).parent
    options = [
        f"--gpu-architecture=sm_{capability}",
        "--std=c++20",
        "--device-as-default-execution-space",
        f"--include-path={folder}",
        f"--include-path={Path(libraries.__file__).parent}",
        f"-DJAXSCP_SIZES={sizes}",
        f"-DJAXSCP_THREADS={threads}",
        f"-DJAXSCP_BLOCKS={blocks}",
    ]
    source = (folder / "kernel.cu").read_bytes()

    def checked(result: Any, *values: Any) -> Any:
        if int(result) != 0:
            raise RuntimeError(f"NVIDIA's compiler: {result}")
        return values[0] if values else None

    program = checked(*nvrtc.nvrtcCreateProgram(source, b"kernel.cu", 0, [], []))
    try:
        (result,) = nvrtc.nvrtcCompileProgram(program, len(options), [option.encode() for option in options])
        if int(result) != 0:
            log = bytearray(checked(*nvrtc.nvrtcGetProgramLogSize(program)))
            checked(*nvrtc.nvrtcGetProgramLog(program, log))
            said = log.decode(errors="replace").strip("\0\n ")
            message = (
                f"jaxscp: the interior point's kernel does not compile, and it runs as JAX ({result}: {said})"
            )
            warnings.warn(message, stacklevel=2)
            return None
        image = bytearray(checked(*nvrtc.nvrtcGetCUBINSize(program)))
        checked(*nvrtc.nvrtcGetCUBIN(program, image))
    finally:
        checked(*nvrtc.nvrtcDestroyProgram(program))
    return bytes(image)


def attributes(program: StagedProgram) -> dict:
    """What a call carries with it for the kernel's sake."""
    image = _kernel(program)
    if image is None:
        raise RuntimeError("jaxscp: no GPU here that the interior point's kernel runs on")
    name = hashlib.sha256(image).hexdigest()
    numbers = {"blocks": np.int64(BLOCKS), "threads": np.int64(THREADS)}
    return {"image": np.frombuffer(image, np.uint8), "name": name, **numbers}
