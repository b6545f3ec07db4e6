"""Planners into files, which ``load`` reads."""

import json
import os
import pathlib
import zipfile
from collections.abc import Mapping
from typing import Any

import jax
from jax.experimental import serialize_executable

from jaxscp.aot.aot import Program, TracedPlanner, compile_programs
from jaxscp.aot.archive import COMPILED, FORMAT, PROGRAMS, fingerprint
from jaxscp.aot.cache_folder import without_cache
from jaxscp.aot.pytree_spec import spec_of


def programs_of(traced: TracedPlanner) -> dict[str, jax.stages.Compiled]:
    """The programs, compiled so that they can be stored."""
    with without_cache():
        return compile_programs(traced.programs)


def write(
    file: str | os.PathLike,
    traced: TracedPlanner,
    programs: Mapping[str, jax.stages.Compiled],
    portable: bool = True,
) -> None:
    """Store a planner; the file appears whole or not at all.

    Args:
        file: to write.
        traced: the planner.
        programs: its compiled programs.
        portable: whether to store the portable form too, for other machines.
    """
    header = _header(traced)
    target = pathlib.Path(file)
    partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
    try:
        with zipfile.ZipFile(partial, "w") as archive:
            for name in PROGRAMS:
                if portable:
                    text = _portable(traced.programs[name])
                    archive.writestr(f"{name}.stablehlo", text, zipfile.ZIP_DEFLATED)
                executable, _, _ = serialize_executable.serialize(programs[name])
                header["compiled"] += called_targets(executable)
                header["lapack"] |= b"lapack_" in executable
                archive.writestr(f"{name}.executable", executable)
            archive.writestr("header.json", json.dumps(header))
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def called_targets(executable: bytes) -> list[str]:
    """Targets of compiled libraries whose names stand in a program.

    The name of a CPU target may be part of a GPU target's name; so a GPU program may list the CPU target too, which
    then must be installed as well.
    """
    return [target for target in COMPILED if target.encode() in executable]


def _header(traced: TracedPlanner) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "nodes": traced.nodes,
        "batch_size": traced.batch_size,
        "scenario": traced.scenario,
        "solution": spec_of(traced.solution),
        "arguments": {name: len(program.shapes) for name, program in traced.programs.items()},
        "results": {
            "setup": len(traced.solve.shapes),
            "solve": len(traced.conclude.shapes),
            "conclude": len(jax.tree.leaves(traced.solution)),
        },
        "platform": jax.default_backend(),
        "machine": fingerprint(),
        "compiled": [],
        "lapack": False,
    }


def _portable(program: Program) -> bytes:
    from jax import export  # slow to import

    checks = [export.DisabledSafetyCheck.custom_call(target) for target in COMPILED]
    return bytes(export.export(program.function, disabled_checks=checks)(*program.shapes).serialize())
