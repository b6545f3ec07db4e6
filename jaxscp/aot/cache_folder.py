"""A folder for what is compiled: whole planners (``kept``), and JAX's own cache for all else. Nothing here runs unless
it is called."""

import contextlib
import os
import pathlib
from collections.abc import Iterator

import jax
from jax.experimental.compilation_cache import compilation_cache

_folder: pathlib.Path | None = None


def use_cache(folder: str | os.PathLike | None) -> None:
    """Keep what this process compiles in a folder, and look there before compiling.

    A planner is kept whole: a later process, with the same jaxscp and jax on the same kind of machine, neither traces
    nor compiles it for scenarios of the same shape. That holds for plain calls of planners made of jaxscp's own parts.
    For all else, ``vmap``, derivatives, your own methods, JAX's own cache is switched on, which changes its
    configuration for the whole process; what it keeps must still be traced. What was compiled before the call is not
    kept.

    Args:
        folder: made if it is missing. It holds machine code: use one that only you can write to. None keeps nothing
            from now on.

    Raises:
        OSError: if there is no such folder and none can be made.

    Example:
        >>> import jaxscp, tempfile
        >>> jaxscp.use_cache(tempfile.mkdtemp())  # doctest: +SKIP
    """
    global _folder
    wanted = None if folder is None else pathlib.Path(folder).absolute()
    if wanted is not None:
        wanted.mkdir(parents=True, exist_ok=True)
    _folder = wanted
    jax.config.update("jax_compilation_cache_dir", None if _folder is None else str(_folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # else a process that has compiled anything keeps going without


def folder() -> pathlib.Path | None:
    """The folder in use."""
    return _folder


@contextlib.contextmanager
def without_cache() -> Iterator[None]:
    """Compile anew, whatever a cache holds: a program that came out of one cannot be stored again, since on the CPU
    it would lack some of its functions."""
    before = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
        compilation_cache.reset_cache()
