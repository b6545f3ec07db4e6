"""Number of floating-point operations of a function, counted in its jaxpr.

The compiler's ``cost_analysis`` counts a loop's body once and does not count calls of LAPACK. Here a loop's body counts
once for each iteration, and a factorisation by its textbook formula. A loop whose end depends on data counts once.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr

# Operations count per element of the result. Moving, comparing or selecting numbers is no operation.
MOVES = """
broadcast_in_dim reshape transpose concatenate pad slice dynamic_slice dynamic_update_slice gather squeeze rev iota
copy convert_element_type stop_gradient split select_n eq ne lt le gt ge and or not is_finite argmax argmin
"""
FREE = frozenset(MOVES.split())


def flops(function: Callable, *args: Any) -> float:
    """Number of operations of one call."""
    return _of(jax.make_jaxpr(function)(*args).jaxpr)


def flops_of_loop(function: Callable, *args: Any) -> float:
    """Number of operations of one iteration of the largest loop whose end depends on data."""
    return max(map(_of, _while_bodies(jax.make_jaxpr(function)(*args).jaxpr)))


def _while_bodies(jaxpr: Jaxpr) -> Iterator[Jaxpr]:
    for equation in jaxpr.eqns:
        if equation.primitive.name == "while":
            yield equation.params["body_jaxpr"].jaxpr
        else:
            for inner in _inner(equation.params):
                yield from _while_bodies(inner)


def _of(jaxpr: Jaxpr) -> float:
    return sum(map(_of_equation, jaxpr.eqns))


def _of_equation(equation: Any) -> float:
    name, inner = equation.primitive.name, _inner(equation.params)
    if name == "scan":
        return equation.params["length"] * sum(map(_of, inner))
    if name == "cond":
        return max(map(_of, inner))
    if inner and name not in ("scatter-add", "scatter", "reduce"):
        return sum(map(_of, inner))
    shapes = [v.aval.shape for v in equation.invars]
    size = sum(math.prod(v.aval.shape) for v in equation.outvars)
    match name:
        case "dot_general":
            (contracted, _), _ = equation.params["dimension_numbers"]
            return 2.0 * size * math.prod(shapes[0][i] for i in contracted)
        case "cholesky":
            return math.prod(shapes[0]) * shapes[0][-1] / 3.0
        case "triangular_solve":
            return math.prod(shapes[1]) * float(shapes[0][-1])
        case "eigh":
            return 9.0 * math.prod(shapes[0]) * shapes[0][-1]  # Golub and Van Loan, with vectors
        case "scatter-add" | "scatter_add":
            return float(math.prod(shapes[2]))
        case _ if name.startswith(("reduce_", "cumsum", "cumprod", "cumlogsumexp", "cummax")):
            return float(math.prod(shapes[0]))
        case _:
            return 0.0 if name in FREE or name.startswith("scatter") else float(size)


def _inner(params: dict[str, Any]) -> list[Jaxpr]:
    values = [v for p in params.values() for v in (p if isinstance(p, list | tuple) else [p])]
    return [
        v.jaxpr if isinstance(v, ClosedJaxpr) else v for v in values if isinstance(v, ClosedJaxpr | Jaxpr)
    ]
