"""Functions of JAX as functions of CasADi: only the statement of a problem is shared, no derivative and no solver."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import jax

from jaxscp.backends.codegen import tape
from jaxscp.backends.codegen.tracing import trace

_OPERATIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "sum": (2, lambda a, b: a + b),
    "difference": (2, lambda a, b: a - b),
    "product": (2, lambda a, b: a * b),
    "reciprocal": (1, lambda a: 1.0 / a),
    "negative": (1, lambda a: -a),
    "choice": (3, lambda which, yes, no: ca.if_else(which, yes, no)),
    "multiply_add": (3, lambda a, b, c: a * b + c),
    "multiply_subtract": (3, lambda a, b, c: c - a * b),
    "abs": (1, ca.fabs),
    "max": (2, ca.fmax),
    "min": (2, ca.fmin),
    **{name: (1, getattr(ca, name)) for name in ("sqrt", "sin", "cos", "exp", "log", "tanh")},
    **{name: (2, getattr(ca, name)) for name in ("lt", "le", "gt", "ge", "eq")},
}
_BY_CODE = {code: _OPERATIONS[name] for name, code in tape.CODES.items()}


def casadi_function(function: Callable[..., jax.Array], *sizes: int, name: str = "f") -> ca.Function:
    """A function of float64 vectors, for CasADi's variables.

    Args:
        function: pure, of vectors of these sizes; returns one array. It may close over numbers, but not over tracers.
        sizes: of its arguments.
        name: of the result.

    Raises:
        CannotTrace: if the function is not arithmetic alone.
    """
    traced = trace(function, *((size,) for size in sizes))
    assert not traced.hoisted, "closes over tracers"
    (output,) = traced.outputs
    recorded = tape.record(list(output.ravel()), sum(sizes))
    arguments = [ca.SX.sym(f"x{i}", size) for i, size in enumerate(sizes)]
    inputs = [element for v in arguments for element in ca.vertsplit(v)]
    return ca.Function(name, arguments, [ca.vertcat(*_evaluate(recorded, inputs))])


def _evaluate(recorded: tape.Tape, inputs: Sequence[Any]) -> list[Any]:
    slots: dict[int, Any] = dict(enumerate([*inputs, *recorded.constants.tolist()]))
    for code, to, *operands in recorded.operations.tolist():
        count, operation = _BY_CODE[code]
        slots[to] = operation(*(slots[v] for v in operands[:count]))
    return [slots[v] for v in recorded.outputs.tolist()]
