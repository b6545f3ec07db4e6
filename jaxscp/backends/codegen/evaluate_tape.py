"""Evaluation of a tape by JAX: every number is an array."""

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.codegen import tape

_UNARY: dict[str, Callable[..., Array]] = {
    "reciprocal": lambda a: 1.0 / a,
    "negative": jnp.negative,
    "abs": jnp.abs,
    **{name: getattr(jnp, name) for name in ("sqrt", "sin", "cos", "exp", "log", "tanh")},
}
_BINARY: dict[str, Callable[..., Array]] = {
    "sum": jnp.add,
    "difference": jnp.subtract,
    "product": jnp.multiply,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "lt": lambda a, b: jnp.less(a, b).astype(a.dtype),
    "le": lambda a, b: jnp.less_equal(a, b).astype(a.dtype),
    "gt": lambda a, b: jnp.greater(a, b).astype(a.dtype),
    "ge": lambda a, b: jnp.greater_equal(a, b).astype(a.dtype),
    "eq": lambda a, b: jnp.equal(a, b).astype(a.dtype),
}
_TERNARY: dict[str, Callable[..., Array]] = {
    "choice": lambda which, yes, no: jnp.where(which != 0.0, yes, no),
    "multiply_add": lambda a, b, c: a * b + c,
    "multiply_subtract": lambda a, b, c: c - a * b,
}
_OPERATIONS = {
    tape.CODES[name]: (count, function)
    for count, functions in enumerate((_UNARY, _BINARY, _TERNARY), start=1)
    for name, function in functions.items()
}


def evaluate(recorded: tape.Tape, inputs: list[Array], parameters: Float[Array, "parameters"]) -> list[Array]:
    """Outputs of a tape, arrays of the shape that its inputs have."""
    slots: dict[int, Array] = dict(enumerate([*inputs, *parameters, *recorded.constants.tolist()]))
    for code, to, *operands in recorded.operations.tolist():
        count, function = _OPERATIONS[code]
        slots[to] = function(*(slots[v] for v in operands[:count]))
    return [slots[v] for v in recorded.outputs.tolist()]
