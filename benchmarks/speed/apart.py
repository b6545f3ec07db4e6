"""Functions that are timed in processes of their own, in turns: what one's libraries leave running, threads that wait
for more work, say, holds up no other."""

import multiprocessing
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

REST = 0.1  # s before a turn: for the threads of who ran before to fall asleep


class Apart:
    """A function in a process of its own; a context.

    Args:
        make: (*args) -> the function, which takes nothing and returns what a pipe can carry; of a module.
        args: of ``make``.
        calls: of the function, one after another, in a turn: the first after that of another finds the caches full of
            what is not its own, and is not warm.
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
        """A turn: what the calls returned."""
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
    """What each returned in its turns; the first turn, which may compile, is left out."""
    for function in functions:
        function()
    rounds = [[function() for function in functions] for _ in range(repeats)]
    return [[call for turn in turns for call in turn] for turns in zip(*rounds, strict=True)]
