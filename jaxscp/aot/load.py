"""Planners from files."""

import os
from typing import TYPE_CHECKING

import jax

from jaxscp.aot.archive import InvalidExport, begin, find_lapack, is_here, machine, read
from jaxscp.core.arrays import PRECISION, double_precision

if TYPE_CHECKING:
    from jaxscp.aot.aot import CompiledPlanner


def load(file: str | os.PathLike, *, compile: bool = True) -> "CompiledPlanner":
    """A planner that ``Planner.export`` wrote: it traces nothing, and on the machine it was made on compiles nothing.

    The file holds machine code, which a call runs: load none that you would not run as a program. The code is used
    where jax, jaxlib, device and the processor's instruction sets are those that it was made with, and the answers are
    then bitwise those of the planner. Elsewhere the portable form in the file is compiled (``jaxscp.use_cache`` keeps
    what comes of it). A planner that calls what was compiled at jaxscp's installation needs that where it is loaded,
    and on a GPU one of the same model.

    Args:
        file: its name.
        compile: whether it may be compiled; if not, a file made on another machine is an error.

    Raises:
        InvalidExport: if the file is no such file, of another format or for another platform, or JAX is in float32.
        OSError: if it cannot be read.
    """
    if not double_precision():
        raise InvalidExport(PRECISION)
    archive = read(file)
    header = archive.header
    if header["platform"] != jax.default_backend():
        raise InvalidExport(
            f"{file}: exported for {header['platform']}, but JAX runs on {jax.default_backend()}. Export it there, or "
            f"set JAX_PLATFORMS={header['platform']}."
        )
    here = machine()
    differs = [name for name in here if here[name] != header["machine"].get(name)]
    if header["compiled"] and header["platform"] == "gpu" and "device" in differs:
        made_on = header["machine"].get("device")
        raise InvalidExport(f"{file}: holds a kernel for {made_on}; export the planner on this GPU.")
    if not all(map(is_here, header["compiled"])):
        raise InvalidExport(
            f"{file}: calls what was compiled with jaxscp, and is not here; install jaxscp again with a C++ compiler."
        )
    if differs and not (compile and archive.portable):
        raise InvalidExport(f"{file}: made on another machine, which differs in {', '.join(differs)}.")
    begun = None if differs else begin(archive)
    if header["lapack"]:
        find_lapack()
    from jaxscp.aot import rebuild  # most of what is imported, while threads load the programs

    return rebuild.planner(file, archive, begun)
