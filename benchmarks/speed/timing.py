"""Clocks: of whole calls, of a piece as it runs inside a compiled loop, and of the machine itself."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

ROUND = 0.004  # s: short, so that some rounds fall between what else the machine does
ROUNDS_SECONDS, LEAST_ROUNDS = 0.8, 5
MATMUL = {"cpu": 768, "gpu": 8192}  # rows
TRIAD = {"cpu": 1 << 24, "gpu": 1 << 28}  # float64 numbers an array: far beyond any cache


def elapsed(function: Callable[[], Any]) -> float:
    """Seconds of one call, to the arrival of its arrays."""
    began = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - began


def least_seconds(function: Callable[[], Any]) -> float:
    """Least of many warm calls, for what is compared with sums of such."""
    jax.block_until_ready(function())
    times = []
    while sum(times) < ROUNDS_SECONDS or len(times) < LEAST_ROUNDS:
        times.append(elapsed(function))
    return min(times)


def median_seconds(function: Callable[[], Any], repeats: int) -> float:
    """Median of warm calls; the first, which may compile, is not counted."""
    jax.block_until_ready(function())
    return float(np.median([elapsed(function) for _ in range(repeats)]))


def least_in_turns(functions: Sequence[Callable[[], Any]], turns: int) -> list[float]:
    """Least of warm calls of each, made in turns: what are to be compared then see the same neighbours."""
    for function in functions:
        jax.block_until_ready(function())
    rounds = [[elapsed(function) for function in functions] for _ in range(turns)]
    return np.min(rounds, axis=0).tolist()


class Loop:
    """A piece called again and again inside one compiled loop: without what a call from Python costs.

    To every argument is added a zero that the compiler cannot know to be one, made of the last call's result; else it
    would move the piece out of the loop.
    """

    def __init__(self, function: Callable, *args: Any) -> None:
        """Compile for arguments like these."""
        blank = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), jax.eval_shape(function, *args))

        @jax.jit
        def calls(count, args):
            return jax.lax.fori_loop(0, count, lambda _, last: function(*_tied(args, last)), blank)

        self._calls = calls

    def result(self, *args: Any) -> Any:
        """What the piece returns."""
        return self._calls(1, args)

    def seconds(self, *args: Any) -> float:
        """Of one call; the least of many short rounds, since others use the machine too."""
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
    """What the machine does at best, in float64."""

    flops: float
    """Of a matrix product, 1/s."""
    bandwidth: float
    """Of b += s c on arrays far larger than its caches, bytes/s."""

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
    """Of one pass, in place: fresh memory would cost more than the arithmetic."""
    triad = jax.jit(lambda b, c: b + 3.0 * c, donate_argnums=0)
    b, c = jnp.ones(size), jnp.ones(size)
    times = []
    for _ in range(3 * LEAST_ROUNDS):
        began = time.perf_counter()
        b = jax.block_until_ready(triad(b, c))
        times.append(time.perf_counter() - began)
    return min(times)
