"""The interior point's kernel for NVIDIA GPUs: ``kernel.cu``, compiled for a program's sizes on first use.

NVIDIA's run-time compiler (extra ``cuda``) compiles the kernel from the same headers as the loop for CPUs. The handler
that launches the kernel is compiled together with that loop. Without either, and on other GPUs, the interior point runs
as JAX.
"""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscp.backends import cuda, libraries
from jaxscp.backends.cuda import compiler
from jaxscp.conic.program import StagedProgram

TARGET = libraries.INTERIOR_POINT.on_gpu
THREADS = 256  # per program
BLOCKS = 4  # programs on a multiprocessor at once
ALONE = 512  # threads of a program that is alone on its multiprocessor
WARP = 32


class Sizes(NamedTuple):
    """Sizes of a program, in the order of ``layout.h``."""

    nodes: int
    variables: int
    link_rows: int
    rows: int
    has_norm: bool
    cones: tuple[tuple[int, int], ...]
    """(count, dimension) of each group of cones at a node."""

    def __str__(self) -> str:
        groups = ",".join(f"{{{count},{dimension}}}" for count, dimension in self.cones)
        numbers = [*self[:4], str(self.has_norm).lower(), len(self.cones)]
        return ",".join(map(str, numbers)) + f",{{{groups}}}"

    @property
    def fit(self) -> bool:
        """Whether a warp can eliminate nodes and links, with one lane per eliminated row."""
        return max(self.variables, self.link_rows) <= WARP


def sizes_of(program: StagedProgram) -> Sizes:
    """Sizes of a program."""
    links, rows = program.links.soft.shape[1], program.rows.offset.shape[1]
    cones = tuple((c.offset.shape[1], c.offset.shape[2]) for c in program.cones)
    return Sizes(program.nodes, program.variables, links, rows, program.norm is not None, cones)


def supports(program: StagedProgram) -> bool:
    """Whether there is a kernel for this program on JAX's GPUs; compiles the kernel on first use."""
    return _kernel(program) is not None


def available() -> bool:
    """Whether JAX's GPUs can run the kernel and its handler was compiled; registers the handler with XLA."""
    return cuda.launches(libraries.INTERIOR_POINT)


def _kernel(program: StagedProgram) -> bytes | None:
    here, sizes = cuda.capability(), sizes_of(program)
    return kernel(sizes, here) if here and compiler() and sizes.fit else None


@functools.cache
def kernel(sizes: Sizes, capability: str) -> bytes | None:
    """Machine code (cubin) of the kernel for these sizes; None and a warning if compilation fails."""
    folder = Path(__file__).parent
    return cuda.compile_cubin(
        (folder / "kernel.cu").read_text(),
        capability,
        "the interior point",
        (folder, libraries.HEADERS),
        JAXSCP_SIZES=sizes,
        JAXSCP_THREADS=THREADS,
        JAXSCP_BLOCKS=BLOCKS,
        JAXSCP_ALONE=ALONE,
        JAXSCP_SHARED=cuda.shared_memory_of_multiprocessor(capability),
    )


def attributes(program: StagedProgram) -> dict:
    """Attributes of a call: the kernel's machine code and its launch sizes."""
    cubin = _kernel(program)
    if cubin is None:
        raise RuntimeError("jaxscp: no GPU here that the interior point's kernel runs on")
    launch = {"blocks": BLOCKS, "threads": THREADS, "alone": ALONE}
    return cuda.attributes(cubin) | {name: np.int64(value) for name, value in launch.items()}
