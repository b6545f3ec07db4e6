"""The kernel of the interior point for NVIDIA GPUs: ``kernel.cu``, compiled for a program's sizes when it is needed.

NVIDIA's run-time compiler, in the extra ``cuda``, makes it from the same headers as the loop for CPUs; what launches it
is compiled with that loop. Without either, and on other GPUs, the interior point runs as JAX.
"""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscp import libraries
from jaxscp.conic.program import StagedProgram
from jaxscp.libraries import cuda

TARGET = libraries.INTERIOR_POINT.on_gpu
WARP = 32


class Launch(NamedTuple):
    """What a kernel is compiled for."""

    threads: int
    """That solve a program together."""
    blocks: int
    """Programs that a multiprocessor has at once."""


# As many programs at once as there is room for; or, where there are fewer than multiprocessors, each sooner.
MANY, ALONE = Launch(256, 4), Launch(512, 1)
FEW = 100  # GPUs of the datacentre have more multiprocessors


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
    """Whether a kernel for this program can be compiled, for the GPUs that JAX runs on."""
    here = cuda.capability()
    return here is not None and cuda.compiles_for(here) and sizes_of(program).fit


def available() -> bool:
    """Whether JAX runs on GPUs for the kernel, and what launches it was compiled; makes that known to XLA."""
    return cuda.launches(libraries.INTERIOR_POINT)


@functools.cache
def kernel(sizes: Sizes, capability: str, launch: Launch) -> bytes:
    """The kernel for programs of these sizes, as machine code of the GPU.

    Raises:
        RuntimeError: if it does not compile.
    """
    folder = Path(__file__).parent
    return cuda.machine_code(
        (folder / "kernel.cu").read_text(),
        capability,
        (folder, Path(libraries.__file__).parent),
        JAXSCP_SIZES=sizes,
        JAXSCP_THREADS=launch.threads,
        JAXSCP_BLOCKS=launch.blocks,
    )


def attributes(program: StagedProgram, lanes: int) -> dict:
    """What a call carries with it for the kernel's sake, where there are so many programs."""
    here = cuda.capability()
    if here is None:
        raise RuntimeError("jaxscp: no GPU here that the interior point's kernel runs on")
    launch = ALONE if lanes <= FEW else MANY
    image = kernel(sizes_of(program), here, launch)
    return cuda.attributes(image) | {name: np.int64(value) for name, value in launch._asdict().items()}
