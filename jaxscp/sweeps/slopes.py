"""The operations that the slopes of a stage, and their derivatives, are made of."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.sweeps import tape, tracing
from jaxscp.sweeps.intervals import Intervals


class Slopes(NamedTuple):
    """The slopes of a stage, and where their derivatives in its arguments (state, controls) are not zero."""

    tape: tape.Tape
    parameters: Float[Array, "parameters"]
    jacobian: np.ndarray
    """(entries, 2): row and column."""
    hessian: np.ndarray
    """(entries, 2), of the lower triangle of their price."""


def record(intervals: Intervals, inputs: int, priced: bool) -> Slopes | None:
    """Find the operations that slopes and their derivatives are made of; None if they are not arithmetic alone."""
    n = intervals.states
    arguments = n + intervals.controls(inputs)

    def rate(argument):
        return intervals.rate(argument[:n], argument[n:])

    def all_of(argument, price=None):
        slopes = rate(argument), jax.jacfwd(rate)(argument)
        return (
            slopes if price is None else (*slopes, jax.hessian(lambda a: jnp.dot(rate(a), price))(argument))
        )

    try:
        traced = tracing.trace(all_of, *((arguments,), (n + 1,))[: 1 + priced])
    except tracing.CannotTrace:
        return None
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
