"""Clocks: whole calls, a part inside a compiled loop, and the machine's peak."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

ROUND = 0.004  # s: short, so that other programs disturb only some rounds
ROUNDS_SECONDS, LEAST_ROUNDS = 0.8, 5
MATMUL = {"cpu": 768, "gpu": 8192}  # rows
TRIAD = {"cpu": 1 << 24, "gpu": 1 << 28}  # float64 numbers an array: far beyond any cache


def elapsed(function: Callable[[], Any]) -> float:
    """Seconds of one call, until its arrays are ready."""
    began = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - began


def least_seconds(function: Callable[[], Any]) -> float:
    """Least seconds of many warm calls, for times that are added up."""
    jax.block_until_ready(function())
    times = []
    while sum(times) < ROUNDS_SECONDS or len(times) < LEAST_ROUNDS:
        times.append(elapsed(function))
    return min(times)


def median_seconds(function: Callable[[], Any], repeats: int) -> float:
    """Median seconds of warm calls; the first call may compile and is not counted."""
    jax.block_until_ready(function())
    return float(np.median([elapsed(function) for _ in range(repeats)]))


def least_in_turns(functions: Sequence[Callable[[], Any]], turns: int) -> list[float]:
    """Least seconds of warm calls of each function, in turns: other programs then disturb all alike."""
    for function in functions:
        jax.block_until_ready(function())
    rounds = [[elapsed(function) for function in functions] for _ in range(turns)]
    return np.min(rounds, axis=0).tolist()


class Loop:
    """Repeated calls of a part inside one compiled loop, without the overhead of calls from Python.

    A zero made from the last call's result is added to every argument. The compiler cannot know this zero; otherwise
    it would move the part out of the loop.
    """

    def __init__(self, function: Callable, *args: Any) -> None:
        """Compile for arguments like these."""
        blank = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(function, *args))

        @jax.jit
        def calls(count, args):
            return jax.lax.fori_loop(0, count, lambda _, last: function(*_tied(args, last)), blank)

        self._calls = calls

    def result(self, *args: Any) -> Any:
        """Result of the part."""
        return self._calls(1, args)

    def seconds(self, *args: Any) -> float:
        """Seconds of one call: least of many short rounds, since other programs use the machine too."""
        jax.block_until_ready(self._calls(1, args))
        count = max(1, round(ROUND / max(elapsed(lambda: self._calls(1, args)), 1e-5)))
        return least_seconds(lambda: self._calls(count, args)) / count


def _tied(args: Any, last: Any) -> Any:
    some = jax.tree.leaves(last)[0].ravel()[0]
    zero = jnp.where(some == 0.123456789, 1.0, 0.0)
    return jax.tree.map(
        lambda v: v + zero.astype(v.dtype) if jnp.issubdtype(v.dtype, jnp.floating) else v, args
    )


@dataclass(frozen=True)
class Ceiling:
    """Peak rates of the machine in float64."""

    flops: float
    """Rate of a matrix product, 1/s."""
    bandwidth: float
    """Rate of b += s c on arrays far larger than the caches, bytes/s."""

    def report(self) -> str:
        """A line for people."""
        return (
            f"this machine: {self.flops / 1e9:.1f} GFLOP/s in a float64 matrix product, "
            f"{self.bandwidth / 1e9:.1f} GB/s in a triad"
        )


def ceiling() -> Ceiling:
    """Measure the machine."""
    kind = jax.default_backend()
    rows, size = (table.get(kind, table["gpu"]) for table in (MATMUL, TRIAD))
    square = jnp.ones((rows, rows))
    return Ceiling(
        flops=2.0 * rows**3 / Loop(jnp.matmul, square, square).seconds(square, square),
        bandwidth=3.0 * 8.0 * size / _triad_seconds(size),
    )


def _triad_seconds(size: int) -> float:
    """Seconds of one b += s c, in place: fresh memory would cost more than the arithmetic."""
    triad = jax.jit(lambda b, c: b + 3.0 * c, donate_argnums=0)
    b, c = jnp.ones(size), jnp.ones(size)
    times = []
    for _ in range(3 * LEAST_ROUNDS):
        began = time.perf_counter()
        b = jax.block_until_ready(triad(b, c))
        times.append(time.perf_counter() - began)
    return min(times)
