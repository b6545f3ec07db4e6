"""JAX's own cache of compiled programs, switched on for whole planners. Nothing here runs unless it is called."""

import contextlib
import os
from collections.abc import Iterator

import jax
from jax.experimental.compilation_cache import compilation_cache


def use_cache(folder: str | os.PathLike) -> None:
    """Keep every program that this process compiles in a folder, and look there before compiling.

    This changes the configuration of JAX for the whole process. Programs are found again by a later process with the
    same jax on the same kind of machine; each planner must still be traced. ``Planner.export`` saves that too. Programs
    that were compiled before the call are not kept.

    Args:
        folder: made if it is missing. It holds machine code: use one that only you can write to.

    Example:
        >>> import jaxscp, tempfile
        >>> jaxscp.use_cache(tempfile.mkdtemp())  # doctest: +SKIP
    """
    path = os.path.abspath(os.fspath(folder))
    os.makedirs(path, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", path)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.reset_cache()  # else a process that has compiled anything keeps going without


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
