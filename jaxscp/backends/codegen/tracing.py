"""From a function of arrays to the operations on numbers that it is made of.

Its jaxpr is run on arrays of symbols. What depends on none of its arguments is left to JAX, and enters as parameters.
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


class CannotTrace(Exception):
    """The function does what is no arithmetic on numbers."""


class Known(NamedTuple):
    """An array that JAX finds, as it depends on no argument, and its elements as parameters where they are numbers."""

    value: Any
    elements: np.ndarray | None


class Traced(NamedTuple):
    """A function as operations on numbers."""

    outputs: list[np.ndarray]
    """Arrays of ``Number``, in the order of the leaves of what it returns."""
    known: list[Array]
    """Arrays that its parameters are elements of: the value of one is (array, index)."""

    def parameters(self, which: Sequence[tuple[int, int]]) -> Float[Array, "parameters"]:
        """Values of some parameters."""
        begins, total = {}, 0
        for array in dict.fromkeys(array for array, _ in which):
            begins[array], total = total, total + self.known[array].size
        if not begins:
            return jnp.zeros(0)
        values = jnp.concatenate([jnp.ravel(self.known[array]) for array in begins])
        return values.at[np.array([begins[array] + index for array, index in which])].get(
            mode="promise_in_bounds"
        )


def trace(function: Callable[..., Any], *shapes: tuple[int, ...]) -> Traced:
    """Run a function of float64 arrays of these shapes on symbols.

    The arguments' elements are numbered through, one array after the other. Traced arrays that the function closes over
    become parameters; others are constants.

    Raises:
        CannotTrace: if it does what is no arithmetic on numbers.
    """
    closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes))
    run = _Run()
    begins = np.cumsum([0, *map(math.prod, shapes)])
    arguments = [
        run.leaves("argument", range(begin, begin + math.prod(shape)), shape)
        for begin, shape in zip(begins, shapes, strict=False)
    ]
    outputs = [run.lifted(v) for v in run.jaxpr(closed.jaxpr, closed.consts, arguments)]
    return Traced(outputs, run.known)


class _Run:
    """One run. A value is a NumPy array of ``Number`` or of plain numbers; or ``Known``, or about to be."""

    def __init__(self) -> None:
        self.graph = Graph()
        self.known: list[Array] = []

    def leaves(self, kind: str, values: Iterable[Any], shape: tuple[int, ...]) -> np.ndarray:
        """An array of arguments, parameters or constants."""
        return _array([self.graph.leaf(kind, v) for v in values], shape)

    def given(self, value: Any) -> Any:
        """What a jaxpr was given or has found, as a value."""
        if not isinstance(value, jax.core.Tracer):
            return value
        if value.dtype != jnp.float64:
            return Known(value, None)
        self.known.append(value)
        keys = ((len(self.known) - 1, i) for i in range(value.size))
        return Known(value, self.leaves("parameter", keys, value.shape))

    def lifted(self, value: Any) -> np.ndarray:
        """A value as an array of ``Number``."""
        if isinstance(value, Known):
            if value.elements is None:
                raise CannotTrace(f"arithmetic in {value.value.dtype}")
            return value.elements
        array = np.asarray(value)
        if array.dtype == object:
            return array
        return self.leaves("constant", map(float, array.ravel()), array.shape)

    def jaxpr(self, jaxpr: Any, consts: Any, arguments: Any) -> list[Any]:
        """Values of a jaxpr's outputs."""
        values: dict[Any, Any] = dict(zip(jaxpr.constvars, map(self.given, consts), strict=True))
        values |= zip(jaxpr.invars, arguments, strict=True)
        read = lambda v: values[v] if _is_variable(v) else v.val  # noqa: E731
        for equation in jaxpr.eqns:
            found = self.equation(equation, [read(v) for v in equation.invars])
            values |= zip(equation.outvars, found, strict=True)
        return [read(v) for v in jaxpr.outvars]

    def equation(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """Values of an equation's outputs."""
        name, given = equation.primitive.name, equation.params
        if name in _CALLS:
            inner = given["jaxpr"] if "jaxpr" in given else given["call_jaxpr"]
            return self.jaxpr(getattr(inner, "jaxpr", inner), getattr(inner, "consts", ()), inputs)
        if not any(isinstance(v, Known) for v in inputs):
            return self.on_numbers(equation, inputs)
        if any(isinstance(v, np.ndarray) and v.dtype == object for v in inputs):
            return self.on_numbers(equation, [self.lifted(v) for v in inputs])
        values = [v.value if isinstance(v, Known) else v for v in inputs]
        found = equation.primitive.bind(*values, **given)
        found = found if equation.primitive.multiple_results else [found]
        try:  # what is found from parameters by arithmetic may be zero, which JAX would not say
            elements = self.on_numbers(equation, [self.lifted(v) for v in inputs])
        except CannotTrace:
            return [self.given(v) for v in found]
        return [Known(value, numbers) for value, numbers in zip(found, elements, strict=True)]

    def on_numbers(self, equation: Any, inputs: list[Any]) -> list[np.ndarray]:
        """Values of an equation's outputs, from arrays of ``Number`` or of plain numbers."""
        name, given = equation.primitive.name, equation.params
        symbolic = any(isinstance(v, np.ndarray) and v.dtype == object for v in inputs)
        if name in _MOVES:
            found = _MOVES[name](*map(self.lifted if symbolic else np.asarray, inputs), **given)
            return found if equation.primitive.multiple_results else [found]
        if not symbolic and name in _PLAIN:
            return [np.asarray(_PLAIN[name](*map(np.asarray, inputs), **given))]
        return [self.arithmetic(name, given, [self.lifted(v) for v in inputs])]

    def arithmetic(self, name: str, given: dict, inputs: list[np.ndarray]) -> np.ndarray:
        """An operation on arrays of ``Number``."""
        graph = self.graph
        simple = {
            "add": graph.sum,
            "add_any": graph.sum,
            "sub": graph.difference,
            "mul": graph.product,
            "div": graph.quotient,
            "neg": graph.negative,
            "square": lambda a: graph.product(a, a),
            "select_n": graph.choice,
        }
        if name == "select_n" and len(inputs) != 3:
            raise CannotTrace(f"a choice among {len(inputs) - 1}")
        if name in simple:
            return _each(simple[name], *inputs)
        if name in _KNOWN:
            return _each(functools.partial(graph.other, name, _KNOWN[name]), *inputs)
        if name == "integer_pow":
            return _each(functools.partial(self.power, given["y"]), *inputs)
        if name in _REDUCTIONS:
            axes = given["axes"]
            return self.reduced(_REDUCTIONS[name], np.moveaxis(inputs[0], axes, range(len(axes))), len(axes))
        if name == "convert_element_type" and given["new_dtype"] == jnp.float64:
            return inputs[0]
        if name == "dot_general":
            return self.dot(given["dimension_numbers"], *inputs)
        raise CannotTrace(f"the operation {name}")

    def power(self, exponent: int, base: Any) -> Any:
        """A whole power, by repeated products."""
        if exponent < 0:
            return self.graph.quotient(self.graph.leaf("constant", 1.0), self.power(-exponent, base))
        if exponent == 0:
            return self.graph.leaf("constant", 1.0)
        half = self.power(exponent // 2, base)
        whole = self.graph.product(half, half)
        return self.graph.product(whole, base) if exponent % 2 else whole

    def reduced(self, by: str, values: np.ndarray, axes: int) -> np.ndarray:
        """Sum, or greatest or least, over the leading axes."""
        left = values.shape[axes:]
        if by == "sum":
            function, found = self.graph.sum, self.lifted(np.zeros(left))
        else:
            function = functools.partial(self.graph.other, by, _KNOWN[by])
            found = self.lifted(np.full(left, -np.inf if by == "max" else np.inf))
        for one in values.reshape(-1, 1, *left):
            found = _each(function, found, one[0] if left else one)
        return found.reshape(left)

    def dot(self, dimensions: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """``jax.lax.dot_general``: batch axes, then those of a, then those of b."""
        (sum_a, sum_b), (batch_a, batch_b) = dimensions
        free_a = [i for i in range(a.ndim) if i not in (*sum_a, *batch_a)]
        free_b = [i for i in range(b.ndim) if i not in (*sum_b, *batch_b)]
        a = a.transpose([*sum_a, *batch_a, *free_a])
        b = b.transpose([*sum_b, *batch_b, *free_b])
        a = a.reshape(a.shape + (1,) * len(free_b))
        split = len(sum_b) + len(batch_b)
        b = b.reshape(b.shape[:split] + (1,) * len(free_a) + b.shape[split:])
        return self.reduced("sum", _each(self.graph.product, a, b), len(sum_a))


def _is_variable(v: Any) -> bool:
    return not isinstance(v, jax.extend.core.Literal)


def _array(items: list[Any], shape: tuple[int, ...]) -> np.ndarray:
    array = np.empty(len(items), object)
    array[:] = items
    return array.reshape(shape)


def _each(function: Callable[..., Any], *arrays: np.ndarray) -> np.ndarray:
    found = np.frompyfunc(function, len(arrays), 1)(*arrays)
    return found if isinstance(found, np.ndarray) else _array([found], ())


def _broadcast(a: np.ndarray, shape: Any, broadcast_dimensions: Any, **_: Any) -> np.ndarray:
    one = [1] * len(shape)
    for axis, size in zip(broadcast_dimensions, a.shape, strict=True):
        one[axis] = size
    return np.broadcast_to(a.reshape(one), shape)


def _slice(a: np.ndarray, start_indices: Any, limit_indices: Any, strides: Any, **_: Any) -> np.ndarray:
    strides = strides or (1,) * a.ndim
    return a[tuple(map(slice, start_indices, limit_indices, strides))]


def _pad(a: np.ndarray, value: np.ndarray, padding_config: Any, **_: Any) -> np.ndarray:
    if any(low < 0 or high < 0 for low, high, _ in padding_config):
        raise CannotTrace("padding by less than nothing")
    shape = [
        low + high + size + max(size - 1, 0) * inner
        for (low, high, inner), size in zip(padding_config, a.shape, strict=True)
    ]
    whole = np.broadcast_to(value, shape).copy()
    where = [
        slice(low, low + max(size * (inner + 1) - inner, 0), inner + 1)
        for (low, _, inner), size in zip(padding_config, a.shape, strict=True)
    ]
    whole[tuple(where)] = a
    return whole


def _split(a: np.ndarray, sizes: Any, axis: int, **_: Any) -> list[np.ndarray]:
    return np.split(a, np.cumsum(sizes)[:-1], axis)


_REDUCTIONS = {"reduce_sum": "sum", "reduce_max": "max", "reduce_min": "min"}
_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint")

# Where numbers go, and not what they become.
_MOVES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda *a, dimension, **_: np.concatenate(a, dimension),
    "copy": lambda a, **_: a,
    "expand_dims": lambda a, dimensions, **_: np.expand_dims(a, dimensions),
    "pad": _pad,
    "reshape": lambda a, new_sizes, **_: a.reshape(new_sizes),
    "rev": lambda a, dimensions, **_: np.flip(a, dimensions),
    "slice": _slice,
    "split": _split,
    "squeeze": lambda a, dimensions, **_: np.squeeze(a, tuple(dimensions)),
    "stack": lambda *a, axis, **_: np.stack(a, axis),
    "stop_gradient": lambda a, **_: a,
    "tile": lambda a, reps, **_: np.tile(a, reps),
    "transpose": lambda a, permutation, **_: np.transpose(a, permutation),
    "unstack": lambda a, axis, **_: [np.squeeze(v, axis) for v in np.split(a, a.shape[axis], axis)],
}

# Of plain numbers, when no symbol is among them: what identity matrices are made of.
_PLAIN: dict[str, Callable[..., Any]] = {
    "iota": lambda dtype, shape, dimension, **_: np.broadcast_to(
        np.arange(shape[dimension]).reshape([-1 if i == dimension else 1 for i in range(len(shape))]), shape
    ),
    "add": lambda a, b, **_: np.add(a, b),
    "eq": lambda a, b, **_: np.equal(a, b),
    "convert_element_type": lambda a, new_dtype, **_: a.astype(new_dtype),
}

# Elementary functions, by the names that jaxprs give them.
_KNOWN: dict[str, Callable[..., Any]] = {
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "exp": math.exp,
    "log": math.log,
    "tanh": math.tanh,
    "max": max,
    "min": min,
    "abs": abs,
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "eq": lambda a, b: float(a == b),
}
