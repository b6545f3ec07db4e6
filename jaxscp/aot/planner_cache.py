"""Planners that were compiled before: in this process, or in the folder of ``use_cache``, where they are found by what
they are made of."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import pathlib
import warnings
from typing import TYPE_CHECKING, Any

import jax

from jaxscp.aot import archive, cache_folder, export
from jaxscp.aot.aot import CompiledPlanner, compiled, with_programs, without_obstacles
from jaxscp.aot.load import load
from jaxscp.aot.pytree_spec import Description, spec_of
from jaxscp.backends.xla import is_traced, options
from jaxscp.landing.scenario import LandingScenario

if TYPE_CHECKING:
    from jaxscp.planner.planner import Planner

PACKAGE = __name__.partition(".")[0]
CODE = (".py", ".so")
MOST = 16  # compiled planners of a process, the last ones called: each holds a thousand memory mappings
CONFIGURATION = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_disable_jit")


def kept(planner: Planner, scenario: LandingScenario, *more: Any) -> CompiledPlanner | None:
    """The planner compiled for scenarios like this one, its programs side by side: from the folder in use, or for it,
    or for this process alone. None where a call is part of another program, or not one for JAX's default device.

    Args:
        planner: to compile.
        scenario: of the call.
        more: arrays that the call is about, besides.
    """
    bare = without_obstacles(scenario)
    if not _plain((bare, more)):
        return None
    leaves, tree = jax.tree.flatten(bare)
    shapes = tuple(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in leaves)
    return _kept(cache_folder.folder(), planner, tree, shapes, tuple(_settings().values()))


def _plain(arrays: Any) -> bool:
    if is_traced(arrays) or jax.config.jax_default_device or jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]
        return False
    here = {jax.devices()[0]}
    return all(leaf.devices() == here for leaf in jax.tree.leaves(arrays) if isinstance(leaf, jax.Array))


@functools.lru_cache(maxsize=MOST)
def _kept(
    folder: pathlib.Path | None, planner: Planner, tree: Any, shapes: tuple, settings: tuple
) -> CompiledPlanner:
    like = jax.tree.unflatten(tree, shapes)
    file = folder and _file(folder, planner, like)
    if file is None:
        return compiled(planner.plan_ahead(like))
    return _found(file) or _made(file, planner, like)


def _file(folder: pathlib.Path, planner: Planner, like: LandingScenario) -> pathlib.Path | None:
    """None for what cannot be kept."""
    try:
        parts = [spec_of(planner), spec_of(like)]
    except TypeError:
        return None
    return folder / f"planner-{_digest(parts)}.jaxscp" if _ours(parts) else None


def _ours(part: Description) -> bool:
    """Whether all classes are this package's: of others, a name does not tell what they do."""
    if isinstance(part, dict):
        return part.get("class", PACKAGE).partition(".")[0] == PACKAGE and all(map(_ours, part.values()))
    return not isinstance(part, list) or all(map(_ours, part))


def _digest(parts: list[Description]) -> str:
    """Of all that decides what a planner does."""
    surroundings = [archive.machine(), _settings(), options(), os.environ.get("XLA_FLAGS", ""), _code()]
    text = json.dumps([*parts, *surroundings], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _settings() -> dict[str, str]:
    return {name: str(getattr(jax.config, name)) for name in CONFIGURATION}


@functools.cache
def _code() -> str:
    """Of this package, as it is installed."""
    digest = hashlib.sha256()
    root = pathlib.Path(__file__).parents[1]
    for file in sorted(file for file in root.rglob("*") if file.suffix in CODE):
        digest.update(f"{file.relative_to(root)}".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _found(file: pathlib.Path) -> CompiledPlanner | None:
    if not file.exists():
        return None
    try:
        return load(file, compile=False)
    except (archive.InvalidExport, OSError) as error:
        warnings.warn(f"jaxscp: the kept planner is made again: {error}", stacklevel=2)
        return None


def _made(file: pathlib.Path, planner: Planner, like: LandingScenario) -> CompiledPlanner:
    plan = planner.plan_ahead(like)
    programs = export.programs_of(plan)
    try:
        export.write(file, plan, programs, portable=False)
    except Exception as error:  # a disk that is full, a solver on the host: the plan itself is none the worse
        warnings.warn(f"jaxscp: the planner cannot be kept: {error}", stacklevel=2)
    return with_programs(plan, programs)
