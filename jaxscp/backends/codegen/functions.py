"""A function and its derivatives as tapes."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import tape, tracing
from jaxscp.backends.codegen.graph import Number


class Function(NamedTuple):
    """The values, and where derivatives in the arguments are not zero.

    Its tapes' places begin with the arguments, a price of every value, and data, which have no derivatives.
    """

    arguments: int
    values: int
    data: int
    first: tape.Tape
    """The values, then the Jacobian's entries."""
    second: tape.Tape
    """Entries of the Hessian of the priced sum."""
    parameters: tuple[Float[Array, "_"], Float[Array, "_"]]
    """Of both."""
    jacobian: np.ndarray
    """(entries, 2): row and column."""
    hessian: np.ndarray
    """(entries, 2), of the lower triangle."""


def record(function: Callable[..., Array], arguments: int, data: Sequence[Array], order: int) -> Function:
    """Find the operations that a function of (arguments, *data) is made of, and its derivatives up to an order.

    Raises:
        CannotTrace: if they are not arithmetic alone.
    """
    if not libraries.in_float64(data):
        raise tracing.CannotTrace("data that are no float64")
    like = jax.ShapeDtypeStruct((arguments,), jnp.float64)
    values = jax.eval_shape(function, like, *data).shape[0]

    def all_of(argument, price, *data):
        value = lambda a: function(a, *data)  # noqa: E731
        found = [value(argument)]
        if order > 0:
            found.append(jax.jacfwd(value)(argument))
        if order > 1:
            found.append(jax.hessian(lambda a: jnp.dot(value(a), price))(argument))
        return found

    shapes = [(arguments,), (values,), *(v.shape for v in data)]
    traced = tracing.trace(all_of, *shapes) if values else tracing.Traced([], [])
    results, jacobian, hessian = [*traced.outputs, *_NOTHING[len(traced.outputs) :]]
    in_jacobian, in_hessian = _not_zero(jacobian), _not_zero(hessian, lower=True)
    inputs = arguments + values + sum(v.size for v in data)
    first = tape.record([*results, *_at(jacobian, in_jacobian)], inputs)
    second = tape.record(_at(hessian, in_hessian), inputs)
    parameters = traced.parameters(first.parameters), traced.parameters(second.parameters)
    data_size = inputs - arguments - values
    return Function(arguments, values, data_size, first, second, parameters, in_jacobian, in_hessian)


_NOTHING = np.zeros(0, object), np.zeros((0, 0), object), np.zeros((0, 0), object)


def _at(matrix: Any, where: np.ndarray) -> list[Number]:
    return [matrix[r, c] for r, c in where]


def _not_zero(matrix: np.ndarray, lower: bool = False) -> np.ndarray:
    pairs = [
        (r, c) for (r, c), number in np.ndenumerate(matrix) if number.known != 0.0 and (r >= c or not lower)
    ]
    return np.array(pairs, np.int32).reshape(-1, 2)
