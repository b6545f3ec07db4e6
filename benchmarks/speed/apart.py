"""Functions timed in turns, each in its own process: idle threads of one library must not slow down another."""

import multiprocessing
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

REST = 0.1  # s before a turn, so that threads of the previous process go to sleep


class Apart:
    """A function in its own process; a context manager.

    Args:
        make: (*args) -> function, at the top level of a module. The function takes no argument and returns a value
            that can be pickled.
        args: arguments of ``make``.
        calls: number of successive calls in a turn. The first call is not warm: another process has used the caches.
    """

    def __init__(self, make: Callable[..., Callable[[], Any]], *args: Any, calls: int = 1) -> None:
        self._calls = calls
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, make, args), daemon=True)
        self._process.start()

    def __enter__(self) -> "Apart":
        return self

    def __exit__(self, *_: Any) -> None:
        self._process.terminate()
        self._process.join()

    def __call__(self) -> list[Any]:
        """Results of the calls of one turn."""
        time.sleep(REST)
        self._pipe.send(self._calls)
        found, error = self._pipe.recv()
        if error is not None:
            raise RuntimeError(error)
        return found


def _serve(pipe: Connection, make: Callable[..., Callable[[], Any]], args: tuple) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    function = None
    while True:
        calls = pipe.recv()
        try:
            function = function or make(*args)
            pipe.send(([function() for _ in range(calls)], None))
        except Exception:
            pipe.send((None, traceback.format_exc()))


def in_turns(functions: Sequence[Apart], repeats: int) -> list[list[Any]]:
    """Results of each function over all turns, without the first turn, which may compile."""
    for function in functions:
        function()
    rounds = [[function() for function in functions] for _ in range(repeats)]
    return [[call for turn in turns for call in turn] for turns in zip(*rounds, strict=True)]
