"""A planner from the contents of a file."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future

import jax

from jaxscp.aot.aot import CompiledPlanner, Program, compile_programs
from jaxscp.aot.archive import PROGRAMS, Archive, InvalidExport
from jaxscp.aot.pytree_spec import zeros_of


def planner(
    file: str | os.PathLike,
    archive: Archive,
    loading: dict[str, Future[Callable]] | None,
    classes: Iterable[type],
) -> CompiledPlanner:
    """The planner whose programs are loading; without them, compiled from its portable form."""
    header = archive.header
    try:
        solution = zeros_of(header["solution"], classes)
    except (KeyError, TypeError) as error:
        raise InvalidExport(f"{file}: from another version of jaxscp; export the planner again.") from error
    programs = {name: loading[name].result() for name in PROGRAMS} if loading else _compile_portable(archive)
    return CompiledPlanner(
        nodes=header["nodes"],
        batch_size=header["batch_size"],
        scenario=header["scenario"],
        solution=jax.tree.structure(solution),
        **programs,
    )


def _compile_portable(archive: Archive) -> dict[str, Callable]:
    """The programs, compiled from the portable form for this machine."""
    from jax import export  # slow to import

    forms = {name: export.deserialize(bytearray(archive.portable[name])) for name in PROGRAMS}
    like = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    return compile_programs(
        {name: Program(jax.jit(form.call), [*map(like, form.in_avals)]) for name, form in forms.items()}
    )
