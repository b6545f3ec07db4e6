"""The kernel of the interior point for NVIDIA GPUs: ``kernel.cu``, compiled for a program's sizes when it is needed.

NVIDIA's run-time compiler, in the extra ``cuda``, makes it from the same headers as the loop for CPUs; what launches it
is compiled with that loop. Without either, and on other GPUs, the interior point runs as JAX.
"""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscp.backends import cuda, libraries
from jaxscp.backends.cuda import compiler
from jaxscp.conic.program import StagedProgram

TARGET = libraries.INTERIOR_POINT.on_gpu
THREADS = 256  # that solve a program together
BLOCKS = 4  # programs that a multiprocessor has at once
ALONE = 512  # threads of a program that has a multiprocessor to itself
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


def available() -> bool:
    """Whether JAX runs on GPUs for the kernel, and what launches it was compiled; makes that known to XLA."""
    return cuda.launches(libraries.INTERIOR_POINT)


def _kernel(program: StagedProgram) -> bytes | None:
    here, sizes = cuda.capability(), sizes_of(program)
    return kernel(sizes, here) if here and compiler() and sizes.fit else None


@functools.cache
def kernel(sizes: Sizes, capability: str) -> bytes | None:
    """The kernel for programs of these sizes, as machine code of the GPU; None and a warning if it does not compile."""
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
    )


def attributes(program: StagedProgram) -> dict:
    """What a call carries with it for the kernel's sake."""
    image = _kernel(program)
    if image is None:
        raise RuntimeError("jaxscp: no GPU here that the interior point's kernel runs on")
    launch = {"blocks": BLOCKS, "threads": THREADS, "alone": ALONE}
    return cuda.attributes(image) | {name: np.int64(value) for name, value in launch.items()}
