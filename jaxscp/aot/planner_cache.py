"""Compiled planners of this process, and of the folder of ``use_cache``.

In the folder, a planner is found by a hash of planner, shapes, code, settings and machine.
"""

import dataclasses
import functools
import hashlib
import json
import logging
import os
import pathlib
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax

from jaxscp.aot import archive, cache_folder, export, mappings
from jaxscp.aot.aot import CompiledPlanner, TracedPlanner, compiled, with_programs
from jaxscp.aot.pytree_spec import Spec, spec_of
from jaxscp.aot.recent import Recent
from jaxscp.backends.xla import compiler_options, is_traced

PACKAGE = __name__.partition(".")[0]
LOG = logging.getLogger(PACKAGE)
CODE = (".py", ".so", ".h", ".cu", ".cuh")
MOST = 16  # compiled planners of a process, the last ones called: each holds a thousand memory mappings
CONFIGURATION = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_disable_jit")


@dataclasses.dataclass(frozen=True)
class Maker:
    """How to make a planner for inputs of given shapes; equal if their planners are.

    Args:
        planner: static settings, hashable; its specification is part of the key.
        trace: from inputs of ``jax.ShapeDtypeStruct`` to the traced planner.
        load: from a file to the compiled planner.
    """

    planner: Any
    trace: Callable[[Any], TracedPlanner] = dataclasses.field(compare=False)
    load: Callable[..., CompiledPlanner] = dataclasses.field(compare=False)


def cached(maker: Maker, inputs: Any, *more: Any) -> CompiledPlanner | None:
    """The planner compiled for inputs like these: from the folder in use, or made for it, or for this process alone.

    None where a call is part of another program, or not for JAX's default device.

    Args:
        maker: of the planner.
        inputs: of the call.
        more: further arrays of the call.
    """
    if not _plain((inputs, more)):
        return None
    key = _key(maker, inputs)
    return _PLANNERS.get(key, lambda: _made(*key[:-1]))


def known(maker: Maker, inputs: Any, *more: Any) -> CompiledPlanner | None:
    """The same if this process has it already; None if not.

    Args:
        maker: of the planner.
        inputs: of the call; need not be valid.
        more: further arrays of the call.
    """
    if jax.config.jax_debug_nans or not all(hasattr(leaf, "dtype") for leaf in jax.tree.leaves(inputs)):  # pyright: ignore[reportAttributeAccessIssue]
        return None  # an error of the check is clearer
    return _PLANNERS.known(_key(maker, inputs)) if _plain((inputs, more)) else None


def make_room() -> None:
    """Drop planners if the process has almost too many memory mappings for another program.

    Raises:
        TooManyPrograms: if that does not suffice.
    """
    mappings.make_room(_PLANNERS.clear)


def _key(maker: Maker, inputs: Any) -> tuple:
    leaves, tree = jax.tree.flatten(inputs)
    shapes = tuple(jax.ShapeDtypeStruct(v.shape, v.dtype) for v in leaves)
    return cache_folder.folder(), maker, tree, shapes, tuple(_settings().values())


def _plain(arrays: Any) -> bool:
    if is_traced(arrays) or jax.config.jax_default_device or jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]
        return False
    here = {jax.devices()[0]}
    return all(leaf.devices() == here for leaf in jax.tree.leaves(arrays) if isinstance(leaf, jax.Array))


_PLANNERS: Recent[CompiledPlanner] = Recent(MOST)


def _made(folder: pathlib.Path | None, maker: Maker, tree: Any, shapes: tuple) -> CompiledPlanner:
    make_room()
    like = jax.tree.unflatten(tree, shapes)
    file = folder and _file(folder, maker.planner, like)
    if file is not None and (known := _from_file(file, maker)) is not None:
        return known
    with _logged():
        return compiled(maker.trace(like)) if file is None else _into_file(file, maker, like)


@contextmanager
def _logged() -> Iterator[None]:
    """Log that something compiles: the call is silent meanwhile."""
    began = time.perf_counter()
    LOG.info("compiling for this planner and these shapes, once")
    yield
    LOG.info("compiled in %.1f s", time.perf_counter() - began)


def _file(folder: pathlib.Path, planner: Any, like: Any) -> pathlib.Path | None:
    """File of a planner; None if no file can hold it."""
    try:
        parts = [spec_of(planner), spec_of(like)]
    except TypeError:
        return None
    return folder / f"planner-{_digest(parts)}.jaxscp" if _ours(parts) else None


def _ours(part: Spec) -> bool:
    """Whether all classes are this package's: the name of another class does not determine its code."""
    if isinstance(part, dict):
        return part.get("class", PACKAGE).partition(".")[0] == PACKAGE and all(map(_ours, part.values()))
    return not isinstance(part, list) or all(map(_ours, part))


def _digest(parts: list[Spec]) -> str:
    """Hash of everything that determines a planner's programs."""
    surroundings = [
        archive.fingerprint(),
        _settings(),
        compiler_options(),
        os.environ.get("XLA_FLAGS", ""),
        code_digest(),
    ]
    text = json.dumps([*parts, *surroundings], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _settings() -> dict[str, str]:
    return {name: str(getattr(jax.config, name)) for name in CONFIGURATION}


@functools.cache
def code_digest(root: pathlib.Path = pathlib.Path(__file__).parents[1]) -> str:
    """Hash of all code of this package, as installed: every room, libraries included."""
    digest = hashlib.sha256()
    for file in sorted(file for file in root.rglob("*") if file.suffix in CODE):
        digest.update(f"{file.relative_to(root)}".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _from_file(file: pathlib.Path, maker: Maker) -> CompiledPlanner | None:
    if not file.exists():
        return None
    try:
        return maker.load(file, compile=False)
    except (archive.InvalidExport, OSError) as error:
        warnings.warn(f"jaxscp: the cached planner is made again: {error}", stacklevel=2)
        return None


def _into_file(file: pathlib.Path, maker: Maker, like: Any) -> CompiledPlanner:
    traced = maker.trace(like)
    programs = export.programs_of(traced)
    try:
        export.write(file, traced, programs, portable=False)
    except Exception as error:  # a full disk, a solver on the host: the planner itself works
        warnings.warn(f"jaxscp: the planner cannot be cached: {error}", stacklevel=2)
    return with_programs(traced, programs)
