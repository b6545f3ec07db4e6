"""A folder for compiled programs: whole planners (``planner_cache``), and JAX's own cache for the rest.

Nothing here runs unless it is called.
"""

import contextlib
import os
import pathlib
from collections.abc import Iterator

import jax
from jax.experimental.compilation_cache import compilation_cache

_folder: pathlib.Path | None = None


def use_cache(folder: str | os.PathLike | None) -> None:
    """Store compiled programs of this process in a folder, and look there before compiling.

    Whole planners are stored. A later process neither traces nor compiles them for scenarios of the same shape, if
    jaxscp, jax and the kind of machine are the same. This holds for plain calls of planners made of jaxscp's own
    parts. For ``vmap``, derivatives and your own methods, JAX's own cache is switched on, which changes its
    configuration for the whole process; its programs must still be traced. Programs compiled before the call are not
    stored.

    Args:
        folder: made if it is missing. It holds machine code: use one that only you can write to. None stores nothing
            from now on.

    Raises:
        OSError: if there is no such folder and none can be made.

    Example:
        >>> import jaxscp, tempfile
        >>> jaxscp.use_cache(tempfile.mkdtemp())  # doctest: +SKIP
    """
    global _folder
    path = None if folder is None else pathlib.Path(folder).absolute()
    if path is not None:
        path.mkdir(parents=True, exist_ok=True)
    _folder = path
    jax.config.update("jax_compilation_cache_dir", None if _folder is None else str(_folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # else a process that has compiled anything goes on without the cache


def folder() -> pathlib.Path | None:
    """The folder in use."""
    return _folder


@contextlib.contextmanager
def without_cache() -> Iterator[None]:
    """Compile again, whatever a cache holds.

    A program from a cache cannot be stored again: on the CPU it would miss some of its functions.
    """
    before = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
    jax.config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
        compilation_cache.reset_cache()
