"""A function of arrays as expression nodes: its jaxpr is interpreted on arrays of nodes.

JAX computes all arrays that depend on none of the function's arguments; they enter the graph as parameters.
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.core
import jax.extend.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends.codegen.graph import Graph
from jaxscp.backends.codegen.primitives import (
    CALLS,
    ELEMENTARY,
    MOVEMENT,
    PLAIN,
    REDUCTIONS,
    CannotTrace,
    array_of,
    elementwise,
)


class HoistedArray(NamedTuple):
    """An array that depends on no argument."""

    value: Callable[[], Any]
    """Returns the array, always the same JAX tracer. It is computed when it is needed: most of the time nodes do."""
    elements: np.ndarray | None
    """Its elements as expression nodes; None if they are not float64."""


class TracedFunction(NamedTuple):
    """A function as expression nodes."""

    outputs: list[np.ndarray]
    """Arrays of ``Number``, in the order of the leaves of the function's result."""
    hoisted: list[Array]
    """Arrays whose elements are the parameters: parameter (array, index) is ``hoisted[array].ravel()[index]``."""

    def parameters(self, which: Sequence[tuple[int, int]]) -> Float[Array, "parameters"]:
        """Values of some parameters, given by (array, index)."""
        begins, total = {}, 0
        for array in dict.fromkeys(array for array, _ in which):
            begins[array], total = total, total + self.hoisted[array].size
        if not begins:
            return jnp.zeros(0)
        values = jnp.concatenate([jnp.ravel(self.hoisted[array]) for array in begins])
        return values.at[np.array([begins[array] + index for array, index in which])].get(
            mode="promise_in_bounds"
        )


def trace(function: Callable[..., Any], *shapes: tuple[int, ...]) -> TracedFunction:
    """Expression nodes of a function of float64 arrays.

    Traced arrays that the function closes over become parameters; others are constants.

    Args:
        function: function of arrays.
        shapes: shapes of its arguments, whose elements are numbered through, one array after the other.

    Raises:
        CannotTrace: if the function is not arithmetic alone.
    """
    closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes))
    interpreter = _Interpreter()
    begins = np.cumsum([0, *map(math.prod, shapes)])
    arguments = [
        interpreter.leaves("argument", range(begin, begin + math.prod(shape)), shape)
        for begin, shape in zip(begins, shapes, strict=False)
    ]
    outputs = [interpreter.nodes(v) for v in interpreter.jaxpr(closed.jaxpr, closed.consts, arguments)]
    return TracedFunction(outputs, interpreter.hoisted)


class _Interpreter:
    """Interpreter of jaxprs.

    A value is a NumPy array of ``Number`` or of plain numbers, or a ``HoistedArray``.
    """

    def __init__(self) -> None:
        self.graph = Graph()
        self.hoisted: list[Array] = []
        self.unread: list[Callable[[], list[Any]]] = []
        """Compute values that were not needed yet, the oldest first."""

    def leaves(self, kind: str, values: Iterable[Any], shape: tuple[int, ...]) -> np.ndarray:
        """Array of arguments, parameters or constants."""
        return array_of([self.graph.leaf(kind, v) for v in values], shape)

    def hoist(self, value: Any) -> Any:
        """``HoistedArray`` of a tracer; other values unchanged."""
        if not isinstance(value, jax.core.Tracer):
            return value
        if value.dtype != jnp.float64:
            return HoistedArray(lambda: value, None)
        self.hoisted.append(value)
        keys = ((len(self.hoisted) - 1, i) for i in range(value.size))
        return HoistedArray(lambda: value, self.leaves("parameter", keys, value.shape))

    def nodes(self, value: Any) -> np.ndarray:
        """A value as an array of ``Number``."""
        if isinstance(value, HoistedArray):
            if value.elements is None:
                raise CannotTrace(f"arithmetic in {value.value().dtype}")
            return value.elements
        array = np.asarray(value)
        if array.dtype == object:
            return array
        return self.leaves("constant", map(float, array.ravel()), array.shape)

    def jaxpr(self, jaxpr: Any, consts: Any, arguments: Any) -> list[Any]:
        """Values of a jaxpr's outputs."""
        values: dict[Any, Any] = dict(zip(jaxpr.constvars, map(self.hoist, consts), strict=True))
        values |= zip(jaxpr.invars, arguments, strict=True)
        read = lambda v: values[v] if _is_variable(v) else v.val  # noqa: E731
        for equation in jaxpr.eqns:
            found = self.equation(equation, [read(v) for v in equation.invars])
            values |= zip(equation.outvars, found, strict=True)
        return [read(v) for v in jaxpr.outvars]

    def equation(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """Values of an equation's outputs."""
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            inner = params["jaxpr"] if "jaxpr" in params else params["call_jaxpr"]
            return self.jaxpr(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), inputs)
        if not any(isinstance(v, HoistedArray) for v in inputs):
            return self.on_numbers(equation, inputs)
        if any(isinstance(v, np.ndarray) and v.dtype == object for v in inputs):
            return self.on_numbers(equation, [self.nodes(v) for v in inputs])
        values = functools.cache(lambda: _bind(equation, inputs))
        try:  # arithmetic on nodes finds zeros that a tracer hides
            elements = self.on_numbers(equation, [self.nodes(v) for v in inputs])
        except CannotTrace:
            self.read_all()
            return [self.hoist(v) for v in values()]
        self.unread.append(values)
        return [HoistedArray(lambda i=i: values()[i], numbers) for i, numbers in enumerate(elements)]

    def read_all(self) -> None:
        """Compute all values, in order: each one's inputs are ready, so that a long chain needs no deep recursion."""
        for values in self.unread:
            values()
        self.unread.clear()

    def on_numbers(self, equation: Any, inputs: list[Any]) -> list[np.ndarray]:
        """Values of an equation's outputs, from arrays of ``Number`` or of plain numbers."""
        name, params = equation.primitive.name, equation.params
        symbolic = any(isinstance(v, np.ndarray) and v.dtype == object for v in inputs)
        if name in MOVEMENT:
            found = MOVEMENT[name](*map(self.nodes if symbolic else np.asarray, inputs), **params)
            return found if equation.primitive.multiple_results else [found]
        if not symbolic and name in PLAIN:
            return [np.asarray(PLAIN[name](*map(np.asarray, inputs), **params))]
        return [self.arithmetic(name, params, [self.nodes(v) for v in inputs])]

    def arithmetic(self, name: str, params: dict, inputs: list[np.ndarray]) -> np.ndarray:
        """Result of a primitive on arrays of ``Number``."""
        graph = self.graph
        simple = {
            "add": graph.sum,
            "add_any": graph.sum,
            "sub": graph.difference,
            "mul": graph.product,
            "div": graph.quotient,
            "neg": graph.negative,
            "square": lambda a: graph.product(a, a),
            "one_minus_square": lambda a: graph.difference(graph.leaf("constant", 1.0), graph.product(a, a)),
            "select_n": graph.choice,
        }
        if name == "select_n" and len(inputs) != 3:
            raise CannotTrace(f"a choice among {len(inputs) - 1}")
        if name in simple:
            return elementwise(simple[name], *inputs)
        if name in ELEMENTARY:
            return elementwise(functools.partial(graph.other, name, ELEMENTARY[name]), *inputs)
        if name == "integer_pow":
            return elementwise(functools.partial(self.power, params["y"]), *inputs)
        if name in REDUCTIONS:
            axes = params["axes"]
            return self.reduced(REDUCTIONS[name], np.moveaxis(inputs[0], axes, range(len(axes))), len(axes))
        if name == "convert_element_type" and params["new_dtype"] == jnp.float64:
            return inputs[0]
        if name == "dot_general":
            return self.dot(params["dimension_numbers"], *inputs)
        raise CannotTrace(f"the operation {name}")

    def power(self, exponent: int, base: Any) -> Any:
        """An integer power, by repeated squaring."""
        if exponent < 0:
            return self.graph.quotient(self.graph.leaf("constant", 1.0), self.power(-exponent, base))
        if exponent == 0:
            return self.graph.leaf("constant", 1.0)
        half = self.power(exponent // 2, base)
        even = self.graph.product(half, half)
        return self.graph.product(even, base) if exponent % 2 else even

    def reduced(self, by: str, values: np.ndarray, axes: int) -> np.ndarray:
        """Sum, maximum or minimum over so many leading axes."""
        left = values.shape[axes:]
        if by == "sum":
            function, found = self.graph.sum, self.nodes(np.zeros(left))
        else:
            function = functools.partial(self.graph.other, by, ELEMENTARY[by])
            found = self.nodes(np.full(left, -np.inf if by == "max" else np.inf))
        for one in values.reshape(-1, 1, *left):
            found = elementwise(function, found, one[0] if left else one)
        return found.reshape(left)

    def dot(self, dimensions: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """``jax.lax.dot_general``: batch axes, then free axes of a, then free axes of b."""
        (sum_a, sum_b), (batch_a, batch_b) = dimensions
        free_a = [i for i in range(a.ndim) if i not in (*sum_a, *batch_a)]
        free_b = [i for i in range(b.ndim) if i not in (*sum_b, *batch_b)]
        a = a.transpose([*sum_a, *batch_a, *free_a])
        b = b.transpose([*sum_b, *batch_b, *free_b])
        a = a.reshape(a.shape + (1,) * len(free_b))
        split = len(sum_b) + len(batch_b)
        b = b.reshape(b.shape[:split] + (1,) * len(free_a) + b.shape[split:])
        return self.reduced("sum", elementwise(self.graph.product, a, b), len(sum_a))


def _bind(equation: Any, inputs: list[Any]) -> list[Any]:
    """JAX's values of an equation's outputs."""
    values = [v.value() if isinstance(v, HoistedArray) else v for v in inputs]
    found = equation.primitive.bind(*values, **equation.params)
    return found if equation.primitive.multiple_results else [found]


def _is_variable(v: Any) -> bool:
    return not isinstance(v, jax.extend.core.Literal)
