"""Planners into files, which ``loading`` reads."""

import json
import os
import pathlib
import zipfile
from collections.abc import Mapping

import jax
from jax.experimental import serialize_executable

from jaxscp.aot.aot import Plan, Program, side_by_side
from jaxscp.aot.archive import COMPILED, FORMAT, PROGRAMS, machine
from jaxscp.aot.cache_folder import without_cache
from jaxscp.aot.pytree_spec import spec_of


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
        "solution": spec_of(plan.solution),
        "arguments": {name: len(program.shapes) for name, program in plan.programs.items()},
        "results": {
            "setup": len(plan.solve.shapes),
            "solve": len(plan.conclude.shapes),
            "conclude": len(jax.tree.leaves(plan.solution)),
        },
        "platform": jax.default_backend(),
        "machine": machine(),
        "compiled": [],
        "lapack": False,
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
                header["lapack"] |= b"lapack_" in executable
                archive.writestr(f"{name}.executable", executable)
            archive.writestr("header.json", json.dumps(header))
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def _portable(program: Program) -> bytes:
    from jax import export  # slow to import

    checks = [export.DisabledSafetyCheck.custom_call(target) for target in COMPILED]
    return bytes(export.export(program.function, disabled_checks=checks)(*program.shapes).serialize())
