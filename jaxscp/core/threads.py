"""A function of many items, on several threads."""

import collections
import concurrent.futures
import os
from collections.abc import Callable, Generator, Iterable
from typing import Any, TypeVar

import jax

from jaxscp.core.arrays import double_precision

Item = TypeVar("Item")
Result = TypeVar("Result")

# Items a thread that are begun or finished but not yet taken: a slow item does not stop the others.
IN_FLIGHT = 8


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def in_order(
    function: Callable[[Item], Result], items: Iterable[Item], workers: int, in_flight: int | None = None
) -> Generator[Result, None, None]:
    """Results in the order of the items, which are drawn as they are needed.

    An exception, Ctrl-C among them, ends it at once: items that have not begun are dropped, and the threads end after
    their present item. Threads help where the function leaves Python, as calls of compiled programs do.

    Args:
        function: of one item. It runs with this thread's precision and default device.
        items: any number.
        workers: threads; with one, the function runs in the calling thread.
        in_flight: items that are begun, or finished and not yet taken; some a worker by default.

    Example:
        >>> from jaxscp.core.threads import in_order
        >>> list(in_order(lambda v: v * v, range(5), workers=2))
        [0, 1, 4, 9, 16]
    """
    if workers == 1:
        yield from map(function, items)
        return
    act = _with_settings(function)
    pool = concurrent.futures.ThreadPoolExecutor(workers, "jaxscp")
    pending: collections.deque[Any] = collections.deque()
    most = in_flight or IN_FLIGHT * workers
    try:
        for item in items:
            pending.append(pool.submit(act, item))
            if len(pending) >= most:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def beside(function: Callable[[], Result]) -> "concurrent.futures.Future[Result]":
    """Call a function in another thread, with this thread's precision and default device.

    Example:
        >>> from jaxscp.core.threads import beside
        >>> beside(lambda: 2 + 3).result()
        5
    """
    act = _with_settings(lambda _: function())
    pool = concurrent.futures.ThreadPoolExecutor(1, "jaxscp")
    try:
        return pool.submit(act, None)
    finally:
        pool.shutdown(wait=False)


def _with_settings(function: Callable[[Item], Result]) -> Callable[[Item], Result]:
    """The function, for other threads: JAX's settings belong to a thread."""
    double, device = double_precision(), jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]

    def act(item: Item) -> Result:
        with jax.enable_x64(double), jax.default_device(device):
            return function(item)

    return act
