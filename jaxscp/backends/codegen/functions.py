"""A function and its first and second derivatives as tapes."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import tape, tracing
from jaxscp.backends.codegen.graph import Number
from jaxscp.backends.codegen.trace_cache import traced_once


class TapedFunction(NamedTuple):
    """A function f(a, data) as tapes, with the sparsity of its derivatives in a.

    The tapes' inputs are the arguments a, a multiplier y_k of every value f_k, and the data.
    """

    arguments: int
    """Size of a."""
    values: int
    """Size of f."""
    data: int
    """Size of the data."""
    first: tape.Tape
    """Tape of the values, then of the Jacobian's nonzero entries."""
    second: tape.Tape
    """Tape of the nonzero entries of the Hessian of y . f."""
    parameters: tuple[Float[Array, "_"], ...]
    """Parameters of the first and the second tape."""
    jacobian: np.ndarray
    """(entries, 2): row and column."""
    hessian: np.ndarray
    """(entries, 2): row and column in the lower triangle."""

    @property
    def inputs(self) -> int:
        """Number of the tapes' inputs: a, y and the data."""
        return self.arguments + self.values + self.data


def record(
    function: Callable[..., Array], arguments: int, data: Sequence[Array], order: int
) -> TapedFunction:
    """Tapes of a function of (a, *data), and of its derivatives up to an order.

    Args:
        function: function of (a, *data); returns a vector. One that is a pytree, such as an equinox module, is traced
            once for each structure and shapes of its traced arrays; all else counts by value, functions by identity.
        arguments: size of a.
        data: arrays of the data's shapes.
        order: 0, 1 or 2.

    Raises:
        CannotTrace: if the function is not arithmetic alone.
    """
    if not libraries.in_float64(data):
        raise tracing.CannotTrace("data that are no float64")
    tapes, parameters = traced_once(_tapes, function, arguments, tuple(v.shape for v in data), order)
    return tapes._replace(parameters=parameters)


def _tapes(
    function: Callable[..., Array], arguments: int, data: tuple[tuple[int, ...], ...], order: int
) -> tuple[TapedFunction, tuple[Array, Array]]:
    """Tapes of a function, for data of these shapes, without their parameters; and the parameters."""
    like = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in ((arguments,), *data)]
    values = jax.eval_shape(function, *like).shape[0]

    def with_derivatives(argument, multipliers, *data):
        value = lambda a: function(a, *data)  # noqa: E731
        found = [value(argument)]
        if order > 0:
            found.append(jax.jacfwd(value)(argument))
        if order > 1:
            found.append(jax.hessian(lambda a: jnp.dot(value(a), multipliers))(argument))
        return found

    shapes = [(arguments,), (values,), *data]
    traced = tracing.trace(with_derivatives, *shapes) if values else tracing.TracedFunction([], [])
    results, jacobian, hessian = [*traced.outputs, *_EMPTY[len(traced.outputs) :]]
    in_jacobian, in_hessian = _nonzero(jacobian), _nonzero(hessian, lower=True)
    inputs = sum(map(math.prod, shapes))
    first = tape.record([*results, *_entries(jacobian, in_jacobian)], inputs)
    second = tape.record(_entries(hessian, in_hessian), inputs)
    data_size = inputs - arguments - values
    tapes = TapedFunction(arguments, values, data_size, first, second, (), in_jacobian, in_hessian)
    return tapes, (traced.parameters(first.parameters), traced.parameters(second.parameters))


_EMPTY = np.zeros(0, object), np.zeros((0, 0), object), np.zeros((0, 0), object)


def _entries(matrix: Any, where: np.ndarray) -> list[Number]:
    return [matrix[r, c] for r, c in where]


def _nonzero(matrix: np.ndarray, lower: bool = False) -> np.ndarray:
    pairs = [
        (r, c)
        for (r, c), number in np.ndenumerate(matrix)
        if number.constant != 0.0 and (r >= c or not lower)
    ]
    return np.array(pairs, np.int32).reshape(-1, 2)
