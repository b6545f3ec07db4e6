"""Memory mappings of this process: compiled programs hold many, and Linux ends a process that has too many."""

import gc
import pathlib
from collections.abc import Callable

MAPPINGS = pathlib.Path("/proc/self/maps")
LIMIT = pathlib.Path("/proc/sys/vm/max_map_count")
RESERVE = 6_000  # mappings that must be free before a planner compiles: five default batches


class TooManyPrograms(MemoryError):
    """The process holds so many compiled programs that the next one may end it."""


def count() -> int:
    """Mappings of this process; zero where the system does not tell."""
    return MAPPINGS.read_bytes().count(b"\n") if MAPPINGS.exists() else 0


def limit() -> int:
    """Mappings that the system allows; zero if it does not tell."""
    return int(LIMIT.read_text()) if LIMIT.exists() else 0


def make_room(drop: Callable[[], None], most: int | None = None) -> None:
    """Make sure that another program may be compiled.

    Args:
        drop: drops programs that are held only to be used again.
        most: mappings of the process allowed; the system's limit less a reserve by default.

    Raises:
        TooManyPrograms: if there are too many mappings even so.
    """
    most = limit() - RESERVE if most is None else most
    if count() <= most or limit() == 0:
        return
    drop()
    gc.collect()
    if (found := count()) > most:
        raise TooManyPrograms(
            f"this process holds {found} memory mappings, and Linux ends a process with more than {limit()}. Compiled "
            "programs hold most of them. Drop compiled planners that are no longer needed and call "
            "jax.clear_caches(), or raise the limit (sysctl vm.max_map_count)."
        )
