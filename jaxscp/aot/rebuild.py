"""A planner from what a file held."""

import os
from collections.abc import Callable
from concurrent.futures import Future

import jax

from jaxscp.aot.aot import CompiledPlanner, Program, side_by_side
from jaxscp.aot.archive import PROGRAMS, Archive, InvalidExport
from jaxscp.aot.pytree_spec import zeros_of
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.solver.solution import Solution
from jaxscp.verification.certificate import Certificate

_CLASSES = (Solution, Trajectory, Multipliers, Certificate, History)


def planner(
    file: str | os.PathLike, archive: Archive, begun: dict[str, Future[Callable]] | None
) -> CompiledPlanner:
    """The planner whose programs are being loaded, or without them are compiled from their portable form."""
    header = archive.header
    try:
        solution = zeros_of(header["solution"], _CLASSES)
    except (KeyError, TypeError) as error:
        raise InvalidExport(f"{file}: from another version of jaxscp; export the planner again.") from error
    programs = {name: begun[name].result() for name in PROGRAMS} if begun else _compiled_anew(archive)
    return CompiledPlanner(
        nodes=header["nodes"],
        lanes=header["lanes"],
        scenario=header["scenario"],
        solution=jax.tree.structure(solution),
        **programs,
    )


def _compiled_anew(archive: Archive) -> dict[str, Callable]:
    """The programs, compiled from the portable form for this machine."""
    from jax import export  # slow to import

    forms = {name: export.deserialize(bytearray(archive.portable[name])) for name in PROGRAMS}
    like = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    return side_by_side(
        {name: Program(jax.jit(form.call), [*map(like, form.in_avals)]) for name, form in forms.items()}
    )
