"""What a function of the user's finds outside itself: values that may change between two calls."""

import types
from collections.abc import Callable, Hashable, Iterable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

LIBRARIES = {"builtins", "math", "jax", "jaxlib", "jaxtyping", "numpy", "equinox", __name__.partition(".")[0]}
"""Their functions are the same at every call."""


class NotSeen(Exception):
    """A function reads an object whose content cannot be compared."""


def known_by_values(function: Callable[..., Any]) -> Hashable | None:
    """The function's code, and the values that it finds outside; equal ones compute the same.

    None if it reads what cannot be compared: an object's attribute, say. Such a function has to be traced again.

    Example:
        >>> from jaxscp.core.outside import known_by_values
        >>> doubled, twice = [lambda x: factor * x for factor in (2.0,)], lambda x: 2.0 * x
        >>> known_by_values(doubled[0]) == known_by_values(doubled[0]), known_by_values(doubled[0].__call__) is None
        (True, True)
    """
    try:
        return _Itself(function) if _of_libraries(function) else _function(function, [])
    except NotSeen:
        return None


class _Itself:
    """An object that never changes: equal to itself alone, and kept, so that no other one takes its place."""

    def __init__(self, value: Any):
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


def _function(function: Any, above: list[Any]) -> Hashable:
    """Of a plain Python function."""
    if not isinstance(function, types.FunctionType):
        raise NotSeen
    above = [*above, function]
    found = [function.__globals__[name] for name in _names(function.__code__) if name in function.__globals__]
    found += [cell.cell_contents for cell in function.__closure__ or () if _filled(cell)]
    found += [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    return function.__code__, tuple(_value(v, above) for v in found)


def _names(code: types.CodeType) -> Iterable[str]:
    """Names of globals and attributes that a function reads, and those of the functions in it."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from _names(inner)


def _value(value: Any, above: list[Any]) -> Hashable:
    if isinstance(value, Tracer):
        raise NotSeen
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        return type(value), repr(value)
    if isinstance(value, jax.Array) or _of_libraries(value):
        return _Itself(value)
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.shape, str(value.dtype), value.tobytes()
    if any(value is v for v in above):  # it refers to itself
        return "above", next(i for i, v in enumerate(above) if v is value)
    if type(value) in (tuple, list):
        return type(value), tuple(_value(v, [*above, value]) for v in value)
    if type(value) is dict:
        return dict, tuple((_value(k, [*above, value]), _value(v, [*above, value])) for k, v in value.items())
    return _function(value, above)


def _of_libraries(value: Any) -> bool:
    """Whether it is a module, a class or a function of a library, not an object that one has made."""
    if isinstance(value, types.ModuleType):
        return value.__name__.partition(".")[0] in LIBRARIES
    owner = getattr(value, "__self__", None)
    if not hasattr(value, "__qualname__") or not (owner is None or isinstance(owner, types.ModuleType)):
        return False
    named = getattr(value, "__module__", None) or ""
    # a user's wrapper may bear a library's name
    written = getattr(value, "__globals__", {}).get("__name__", named)
    return all(name.partition(".")[0] in LIBRARIES for name in (named, written))


def _filled(cell: types.CellType) -> bool:
    try:
        cell.cell_contents  # noqa: B018
    except ValueError:
        return False
    return True
