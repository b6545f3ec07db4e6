"""How long two commits take, in turns: each number of a pair is measured next to the other."""

import json
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any

import numpy as np

from benchmarks.commits.builds import Side, in_parallel

Echo = Callable[[str], None]
CALLS = {"default": 15, "paper": 60}  # warm calls of a turn
STARTS = ("cold", "cached", "export")
NAMES = {
    "cold": "cold start, s",
    "first": "first call, which compiles, s",
    "cached": "start with a full cache, s",
    "export": "start from an export, s",
    "default": "warm plan, default mode, s",
    "paper": "warm plan, paper mode, s",
}
REST = 0.1  # s before a turn, in which the threads of the other process fall asleep


class Server:
    """A process that plans when it is asked to; a context."""

    def __init__(self, side: Side, mode: str) -> None:
        command = side.command("serve", {"mode": mode, "calls": CALLS[mode]})
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, env=side.environment(), cwd=side.scratch, stdin=pipe, stdout=pipe, text=True
        )

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._process.kill()
        self._process.communicate()

    def answer(self) -> Any:
        """The next line of the process."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("a process of warm calls has ended")
        return json.loads(line)

    def seconds(self) -> float:
        """Median of a turn's calls."""
        assert self._process.stdin is not None
        time.sleep(REST)
        self._process.stdin.write("turn\n")
        self._process.stdin.flush()
        return self.answer()


def run(old: Side, new: Side, pairs: int, echo: Echo) -> dict[str, Any]:
    """Measure so many pairs, and print a table."""
    sides = old, new
    in_parallel(Side.export, *sides)
    in_parallel(lambda side: _start(side, "cached"), *sides)
    rows: dict[str, list[list[float]]] = {kind: [] for kind in NAMES}
    with ExitStack() as stack:
        servers = {mode: [stack.enter_context(Server(side, mode)) for side in sides] for mode in CALLS}
        for server in [server for both in servers.values() for server in both]:
            server.answer()
        for pair in range(pairs):
            order = (0, 1) if pair % 2 == 0 else (1, 0)
            for kind, seconds in _pair(sides, servers, order).items():
                rows[kind].append(seconds)
            latest = (f"{kind} {rows[kind][-1][0]:.3g} {rows[kind][-1][1]:.3g}" for kind in rows)
            echo(f"pair {pair + 1} of {pairs}, old and new in s: " + ", ".join(latest))
    return _summary(rows, echo)


def _pair(sides: tuple[Side, Side], servers: dict[str, list[Server]], order: tuple[int, int]):
    """Every kind once for both sides, in this order."""
    found: dict[str, list[float]] = {kind: [0.0, 0.0] for kind in NAMES}
    for k in order:
        found["cold"][k], found["first"][k] = _start(sides[k], "cold")
    for kind in ("cached", "export"):
        for k in order:
            found[kind][k], _ = _start(sides[k], kind)
    for mode, both in servers.items():
        for k in order:
            found[mode][k] = both[k].seconds()
    return found


def _start(side: Side, kind: str) -> tuple[float, float]:
    """Seconds from the start of a process to its first plan, and seconds of the call."""
    arguments = {
        "cold": {},
        "cached": {"cache": str(side.scratch / "cache")},
        "export": {"export": side.export()},
    }
    began = time.perf_counter()
    answer = side.run("start", **arguments[kind])
    seconds = time.perf_counter() - began
    if answer["status"] != "converged":
        raise RuntimeError(f"{side.name}: {kind} start ended as {answer['status']}")
    return seconds, answer["seconds"]


def _summary(rows: dict[str, list[list[float]]], echo: Echo) -> dict[str, Any]:
    """Medians, and the ratios' quartiles and range."""
    echo(f"{'':32}{'old':>9}{'new':>9}   new/old: median   quartiles        range")
    found = {}
    for kind, pairs in rows.items():
        old, new = np.transpose(pairs)
        low, first, middle, third, high = np.percentile(new / old, (0, 25, 50, 75, 100))
        before, after = np.median(old), np.median(new)
        echo(
            f"{NAMES[kind]:32}{before:9.4f}{after:9.4f}   {middle:15.3f}   {first:.3f} to {third:.3f}   "
            f"{low:.3f} to {high:.3f}"
        )
        found[kind] = {"old": before, "new": after, "ratio": middle, "ratios": (new / old).tolist()}
    return found
