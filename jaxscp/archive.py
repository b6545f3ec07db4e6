"""A planner in a file: what it is for, its programs in portable form, and as compiled for one machine.

The file is a ZIP archive: ``header.json``, ``*.stablehlo`` (serialised by ``jax.export``) and ``*.executable``
(serialised by ``jax.experimental.serialize_executable``, which pickles).
"""

import hashlib
import json
import os
import pathlib
import platform
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jaxlib
from jax.experimental import serialize_executable

from jaxscp.ahead import Plan, Program, side_by_side
from jaxscp.caching import without_cache
from jaxscp.conic import native as conic
from jaxscp.conic.native import scales
from jaxscp.normal import native as normal
from jaxscp.riccati import native as riccati
from jaxscp.semidefinite import native as semidefinite
from jaxscp.structure import describe
from jaxscp.sweeps import native as sweeps

FORMAT = 5
PROGRAMS = ("setup", "solve", "conclude")
COMPILED = {
    **dict.fromkeys(conic.TARGETS, conic.runs_here),
    scales.TARGET: scales.available,
    **dict.fromkeys(normal.TARGETS, normal.available),
    **dict.fromkeys(riccati.TARGETS, riccati.available),
    **dict.fromkeys(semidefinite.TARGETS, semidefinite.available),
    sweeps.TARGET: sweeps.available,
}
"""What programs may call that was compiled at installation; whether it is here, which makes it known to XLA."""


class InvalidExport(ValueError):
    """A file is no planner that can be loaded here; the message says why."""


class Archive(NamedTuple):
    """What a file holds."""

    header: dict[str, Any]
    portable: dict[str, bytes]
    executable: dict[str, bytes]


def programs_of(plan: Plan) -> dict[str, jax.stages.Compiled]:
    """The programs, compiled so that they can be stored."""
    with without_cache():
        return side_by_side(plan.programs)


def write(
    file: str | os.PathLike, plan: Plan, programs: Mapping[str, jax.stages.Compiled], portable: bool = True
) -> None:
    """Store a planner; the file appears whole or not at all.

    Args:
        file: to write.
        plan: what is to be stored.
        programs: of the plan.
        portable: whether in portable form too, for other machines.
    """
    header = {
        "format": FORMAT,
        "nodes": plan.nodes,
        "lanes": plan.lanes,
        "scenario": plan.scenario,
        "solution": describe(plan.solution),
        "arguments": {name: len(program.shapes) for name, program in plan.programs.items()},
        "results": {
            "setup": len(plan.solve.shapes),
            "solve": len(plan.conclude.shapes),
            "conclude": len(jax.tree.leaves(plan.solution)),
        },
        "platform": jax.default_backend(),
        "machine": machine(),
        "compiled": [],
    }
    target = pathlib.Path(file)
    partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
    try:
        with zipfile.ZipFile(partial, "w") as archive:
            for name in PROGRAMS:
                if portable:
                    archive.writestr(
                        f"{name}.stablehlo", _portable(plan.programs[name]), zipfile.ZIP_DEFLATED
                    )
                executable, _, _ = serialize_executable.serialize(programs[name])
                header["compiled"] += [target for target in COMPILED if target.encode() in executable]
                archive.writestr(f"{name}.executable", executable)
            archive.writestr("header.json", json.dumps(header))
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def _portable(program: Program) -> bytes:
    from jax import export  # slow to import

    checks = [export.DisabledSafetyCheck.custom_call(target) for target in COMPILED]
    return bytes(export.export(program.function, disabled_checks=checks)(*program.shapes).serialize())


def read(file: str | os.PathLike) -> Archive:
    """What ``write`` wrote; raises ``InvalidExport`` if it is something else."""
    try:
        with zipfile.ZipFile(file) as archive:
            header = json.loads(archive.read("header.json"))
            if header["format"] != FORMAT:
                raise InvalidExport(
                    f"{file}: its format is {header['format']}, and this version of jaxscp reads {FORMAT}; export the "
                    "planner again."
                )
            forms = [name for name in PROGRAMS if f"{name}.stablehlo" in archive.namelist()]
            portable = {name: archive.read(f"{name}.stablehlo") for name in forms}
            return Archive(header, portable, {name: archive.read(f"{name}.executable") for name in PROGRAMS})
    except (zipfile.BadZipFile, KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidExport(f"{file}: not a planner that Planner.export wrote: {error}") from error


def machine() -> dict[str, str]:
    """What a compiled program runs on: that and nothing else."""
    device = jax.devices()[0]
    return {
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "device": device.device_kind,
        "runtime": device.client.platform_version,
        "host": platform.machine(),
        "instructions": hashlib.sha256(_instructions().encode()).hexdigest(),
        "compiled": " ".join(str(each.level()) for each in (conic, normal, riccati, semidefinite, sweeps)),
    }


def _instructions() -> str:
    """The processor's instruction sets where the system tells, else the host's name."""
    table = pathlib.Path("/proc/cpuinfo")
    lines = table.read_text().splitlines() if table.exists() else []
    found = {line for line in lines if line.startswith(("flags", "Features"))}
    return "\n".join(sorted(found)) or platform.node()


def executables(archive: Archive) -> dict[str, Callable]:
    """The programs as they were compiled; no compiler runs."""
    device = jax.devices()[0]

    def load(name: str) -> Callable:
        return serialize_executable.deserialize_and_load(
            archive.executable[name],
            jax.tree.structure(((0,) * archive.header["arguments"][name], {})),
            jax.tree.structure([0] * archive.header["results"][name]),
            execution_devices=[device],
        )

    with ThreadPoolExecutor() as threads:
        begun = {name: threads.submit(load, name) for name in PROGRAMS}
        _find_lapack()
        return {name: loading.result() for name, loading in begun.items()}


def _find_lapack() -> None:
    """Have JAX look up the LAPACK routines that the programs call: it does so when it first lowers a program with one,
    and in a process that only runs programs they would be null pointers."""
    jax.jit(jax.numpy.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def compiled_anew(archive: Archive) -> dict[str, Callable]:
    """The programs, compiled from the portable form for this machine."""
    from jax import export  # slow to import

    forms = {name: export.deserialize(bytearray(archive.portable[name])) for name in PROGRAMS}
    like = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    return side_by_side(
        {name: Program(jax.jit(form.call), [*map(like, form.in_avals)]) for name, form in forms.items()}
    )
