"""Planners from files."""

import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import jax

from jaxscp.aot.archive import Archive, InvalidExport, find_lapack, fingerprint, is_here, read, start_loading
from jaxscp.core.arrays import PRECISION, double_precision

if TYPE_CHECKING:
    from jaxscp.aot.aot import CompiledPlanner


def load(
    file: str | os.PathLike, classes: Callable[[], Iterable[type]], *, compile: bool = True
) -> "CompiledPlanner":
    """The planner in a file.

    Args:
        file: its name.
        classes: of the solution's pytree; called while threads load the programs.
        compile: whether the portable form may be compiled; if not, a file from another machine is an error.

    Raises:
        InvalidExport: if the file is no such file, of another format or for another platform, or JAX is in float32.
        OSError: if the file cannot be read.
    """
    if not double_precision():
        raise InvalidExport(PRECISION)
    archive = read(file)
    differs = _check_machine(file, archive)
    if differs and not (compile and archive.portable):
        raise InvalidExport(f"{file}: made on another machine, which differs in {', '.join(differs)}.")
    loading = None if differs else start_loading(archive)
    if archive.header["lapack"]:
        find_lapack()
    from jaxscp.aot import rebuild  # imports the other modules, while threads load the programs

    return rebuild.planner(file, archive, loading, classes())


def _check_machine(file: str | os.PathLike, archive: Archive) -> list[str]:
    """Names of the properties in which this machine differs from the file's."""
    header = archive.header
    if header["platform"] != jax.default_backend():
        raise InvalidExport(
            f"{file}: exported for {header['platform']}, but JAX runs on {jax.default_backend()}. Export it there, or "
            f"set JAX_PLATFORMS={header['platform']}."
        )
    here = fingerprint()
    differs = [name for name in here if here[name] != header["machine"].get(name)]
    if header["compiled"] and header["platform"] == "gpu" and "device" in differs:
        made_on = header["machine"].get("device")
        raise InvalidExport(f"{file}: holds a kernel for {made_on}; export the planner on this GPU.")
    if not all(map(is_here, header["compiled"])):
        raise InvalidExport(
            f"{file}: calls a library that is compiled at jaxscp's installation, and is not here; install jaxscp again "
            "with a C++ compiler."
        )
    return differs
