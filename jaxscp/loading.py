"""Planners from files."""

import os

import jax

from jaxscp.ahead import CompiledPlanner
from jaxscp.archive import COMPILED, InvalidExport, compiled_anew, executables, machine, read
from jaxscp.certificate import Certificate
from jaxscp.lagrangian import FlightMultipliers
from jaxscp.planner import Solution
from jaxscp.scp import History
from jaxscp.structure import prototype
from jaxscp.trajectory import Trajectory
from jaxscp.validation import PRECISION, double_precision

_CLASSES = (Solution, Trajectory, FlightMultipliers, Certificate, History)


def load(file: str | os.PathLike, *, compile: bool = True) -> CompiledPlanner:
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
    if not all(name in COMPILED and COMPILED[name]() for name in header["compiled"]):
        raise InvalidExport(
            f"{file}: calls what was compiled with jaxscp, and is not here; install jaxscp again with a C++ compiler."
        )
    try:
        solution = prototype(header["solution"], _CLASSES)
    except (KeyError, TypeError) as error:
        raise InvalidExport(f"{file}: from another version of jaxscp; export the planner again.") from error
    if differs and not (compile and archive.portable):
        raise InvalidExport(f"{file}: made on another machine, which differs in {', '.join(differs)}.")
    programs = compiled_anew(archive) if differs else executables(archive)
    return CompiledPlanner(
        nodes=header["nodes"],
        lanes=header["lanes"],
        scenario=header["scenario"],
        solution=jax.tree.structure(solution),
        **programs,
    )
