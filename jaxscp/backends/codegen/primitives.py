"""JAX primitives on NumPy arrays of numbers or of expression nodes: data movement, plain arithmetic, functions."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np


class CannotTrace(Exception):
    """The function is not arithmetic alone."""


def array_of(items: list[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Array of objects."""
    array = np.empty(len(items), object)
    array[:] = items
    return array.reshape(shape)


def elementwise(function: Callable[..., Any], *arrays: np.ndarray) -> np.ndarray:
    """Array of a function's values, element by element."""
    found = np.frompyfunc(function, len(arrays), 1)(*arrays)
    return found if isinstance(found, np.ndarray) else array_of([found], ())


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
    padded = np.broadcast_to(value, shape).copy()
    where = [
        slice(low, low + max(size * (inner + 1) - inner, 0), inner + 1)
        for (low, _, inner), size in zip(padding_config, a.shape, strict=True)
    ]
    padded[tuple(where)] = a
    return padded


def _split(a: np.ndarray, sizes: Any, axis: int, **_: Any) -> list[np.ndarray]:
    return np.split(a, np.cumsum(sizes)[:-1], axis)


CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "remat", "checkpoint")
"""Primitives that contain a jaxpr."""

REDUCTIONS = {"reduce_sum": "sum", "reduce_max": "max", "reduce_min": "min"}
"""Reductions, by the operation that they repeat."""

MOVEMENT: dict[str, Callable[..., Any]] = {
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
"""Primitives that move elements and leave their values."""

PLAIN: dict[str, Callable[..., Any]] = {
    "iota": lambda dtype, shape, dimension, **_: np.broadcast_to(
        np.arange(shape[dimension]).reshape([-1 if i == dimension else 1 for i in range(len(shape))]), shape
    ),
    "add": lambda a, b, **_: np.add(a, b),
    "eq": lambda a, b, **_: np.equal(a, b),
    "convert_element_type": lambda a, new_dtype, **_: a.astype(new_dtype),
}
"""Arithmetic on arrays without expression nodes, such as identity matrices."""

ELEMENTARY: dict[str, Callable[..., Any]] = {
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
"""Elementary functions of constants, by JAX's names."""
