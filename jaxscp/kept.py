"""Planners that were compiled before, in the folder of ``use_cache``: found there by what they are made of."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import pathlib
import warnings
from typing import TYPE_CHECKING, Any

import jax

from jaxscp import archive, caching
from jaxscp.ahead import CompiledPlanner, with_programs, without_obstacles
from jaxscp.compiler import inside, options
from jaxscp.mission import LandingScenario
from jaxscp.structure import Description, describe

if TYPE_CHECKING:
    from jaxscp.planner import Planner

PACKAGE = __name__.partition(".")[0]
CODE = (".py", ".so")
CONFIGURATION = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_disable_jit")


def kept(planner: Planner, scenario: LandingScenario) -> CompiledPlanner | None:
    """The planner compiled for scenarios like this one, from the folder or for it; None where none is in use, and for
    what cannot be kept."""
    folder = caching.folder()
    if folder is None:
        return None
    bare = without_obstacles(scenario)
    if inside(bare):
        return None
    leaves, tree = jax.tree.flatten(bare)
    return _kept(folder, planner, tree, tuple(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in leaves))


@functools.cache
def _kept(folder: pathlib.Path, planner: Planner, tree: Any, shapes: tuple) -> CompiledPlanner | None:
    like = jax.tree.unflatten(tree, shapes)
    try:
        parts = [describe(planner), describe(like)]
    except TypeError:
        return None
    if not _ours(parts):
        return None
    file = folder / f"planner-{_digest(parts)}.jaxscp"
    return _found(file) or _made(file, planner, like)


def _ours(part: Description) -> bool:
    """Whether all classes are this package's: of others, a name does not tell what they do."""
    if isinstance(part, dict):
        return part.get("class", PACKAGE).partition(".")[0] == PACKAGE and all(map(_ours, part.values()))
    return not isinstance(part, list) or all(map(_ours, part))


def _digest(parts: list[Description]) -> str:
    """Of all that decides what a planner does."""
    settings = {name: str(getattr(jax.config, name)) for name in CONFIGURATION}
    surroundings = [archive.machine(), settings, options(), os.environ.get("XLA_FLAGS", ""), _code()]
    text = json.dumps([*parts, *surroundings], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@functools.cache
def _code() -> str:
    """Of this package, as it is installed."""
    digest = hashlib.sha256()
    root = pathlib.Path(__file__).parent
    for file in sorted(file for file in root.rglob("*") if file.suffix in CODE):
        digest.update(f"{file.relative_to(root)}".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _found(file: pathlib.Path) -> CompiledPlanner | None:
    from jaxscp.loading import load  # which builds what the planner returns, and so comes after it

    if not file.exists():
        return None
    try:
        return load(file, compile=False)
    except (archive.InvalidExport, OSError) as error:
        warnings.warn(f"jaxscp: the kept planner is made again: {error}", stacklevel=2)
        return None


def _made(file: pathlib.Path, planner: Planner, like: LandingScenario) -> CompiledPlanner:
    plan = planner.plan_ahead(like)
    programs = archive.programs_of(plan)
    try:
        archive.write(file, plan, programs, portable=False)
    except Exception as error:  # a disk that is full, a solver on the host: the plan itself is none the worse
        warnings.warn(f"jaxscp: the planner cannot be kept: {error}", stacklevel=2)
    return with_programs(plan, **programs)
