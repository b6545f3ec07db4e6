"""The pass in C++, for float64 on a CPU: the slopes and their derivatives by a tape, the rest as written there.

XLA runs the tangents of a Runge-Kutta step as hundreds of small operations on arrays that are mostly zero. Here the
zeros are known before, and eight intervals go through each operation in a register.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.sweeps import native, tape, tracing


class Slopes(NamedTuple):
    """The slopes of a stage, and where their derivatives in its arguments (state, controls) are not zero."""

    tape: tape.Tape
    parameters: Float[Array, "parameters"]
    jacobian: np.ndarray
    """(entries, 2): row and column."""
    hessian: np.ndarray
    """(entries, 2), of the lower triangle of their price."""


def prepare(intervals: Any, w: Array, prices: Array | None) -> Callable[..., Any] | None:
    """What goes through these intervals, if it can: from (w, prices) to the fields of a ``Pass``."""
    if w.dtype != jnp.float64 or not native.available():
        return None
    try:
        slopes = record(intervals, w.shape[-1], prices is not None)
    except tracing.CannotTrace:
        return None
    return functools.partial(_call, intervals, slopes)


def record(intervals: Any, inputs: int, priced: bool) -> Slopes:
    """Find the operations that slopes and their derivatives are made of."""
    n = intervals.states
    arguments = n + (inputs - n) // 2

    def rate(argument):
        return intervals.rate(argument[:n], argument[n:])

    def all_of(argument, price=None):
        slopes = rate(argument), jax.jacfwd(rate)(argument)
        return (
            slopes if price is None else (*slopes, jax.hessian(lambda a: jnp.dot(rate(a), price))(argument))
        )

    traced = tracing.trace(all_of, *((arguments,), (n + 1,))[: 1 + priced])
    slopes, jacobian, *rest = traced.outputs
    entries = _not_zero(jacobian)
    triangle = _not_zero(*rest, lower=True) if priced else np.zeros((0, 2), np.int32)
    outputs = [*slopes, *(jacobian[r, c] for r, c in entries), *(rest[0][r, c] for r, c in triangle)]
    recorded = tape.record(outputs, arguments + priced * (n + 1))
    return Slopes(recorded, traced.parameters(recorded.parameters), entries, triangle)


def _not_zero(matrix: np.ndarray, lower: bool = False) -> np.ndarray:
    pairs = [
        (r, c) for (r, c), number in np.ndenumerate(matrix) if number.known != 0.0 and (r >= c or not lower)
    ]
    return np.array(pairs, np.int32).reshape(-1, 2)


def first_inputs(jacobian: np.ndarray, states: int, inputs: int) -> np.ndarray:
    """By row of the path, the first of an interval's inputs that it can depend on; all after it count as such."""
    first = np.array([*range(states), inputs])
    for _ in range(states + 1):
        for row, column in jacobian:
            first[row] = min(first[row], first[column] if column < states else column)
    return first.astype(np.int32)


def _call(intervals: Any, slopes: Slopes, w: Array, prices: Array | None) -> Any:
    n, inputs, priced = intervals.states, w.shape[-1], prices is not None
    kept = intervals.steps // intervals.every
    shapes = [(kept, n + 1), (kept, n + 1, inputs), (inputs, inputs)][: 2 + priced]
    results = [jax.ShapeDtypeStruct((w.shape[0], *shape), w.dtype) for shape in shapes]
    recorded, method = slopes.tape, intervals.method
    numbers = {
        "states": n,
        "controls": (inputs - n) // 2,
        "steps": intervals.steps,
        "every": intervals.every,
        "priced": priced,
        "once": recorded.once,
        "places": recorded.places,
        "parameters": slopes.parameters.size,
    }
    tables = {
        "shares": method.shares,
        "weights": method.weights,
        "table": method.table.ravel(),
        "operations": recorded.operations.ravel(),
        "constants": recorded.constants,
        "outputs": recorded.outputs,
        "jacobian": slopes.jacobian.ravel(),
        "hessian": slopes.hessian.ravel(),
        "first": first_inputs(slopes.jacobian, n, inputs),
    }
    arrays = [w, slopes.parameters] + [prices] * priced
    found = jax.ffi.ffi_call(native.TARGET, results, vmap_method="broadcast_all")(
        *arrays, **{name: np.int64(v) for name, v in numbers.items()}, **tables
    )
    return (*found, None)[:3]
