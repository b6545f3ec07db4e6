"""Identity of a sweep, as plain data: two sweeps may share a folder only if theirs are equal."""

import dataclasses
import hashlib
import inspect
import types
from typing import Any

import jax
import numpy as np

_SMALL = 16  # numbers of an array that are listed, so that a difference says what changed


def described(value: Any) -> Any:
    """Plain data (for JSON) that two values share only if they mean the same.

    Functions are compared by their code, defaults, closures, and the globals that they name: functions of the same
    package, numbers, arrays and dataclasses. Methods and functions of other packages are not followed.

    Example:
        >>> described({"mass": 1.0, "times": (1, 2)})
        {'mass': 1.0, 'times': [1, 2]}
        >>> described(lambda x: x + 1) == described(lambda x: x + 2)
        False
    """
    return _described(value, ())


def _described(value: Any, above: tuple[int, ...]) -> Any:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else repr(value)
    if id(value) in above:
        return "recursion"
    above = (*above, id(value))
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        return _array(np.asarray(value))
    if isinstance(value, dict):
        return {str(k): _described(v, above) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [_described(v, above) for v in value]
    if isinstance(value, types.FunctionType):
        return _function(value, above)
    if isinstance(value, types.MethodType):
        return {"method": _function(value.__func__, above), "of": _described(value.__self__, above)}
    return _object(value, above)


def _array(array: np.ndarray) -> Any:
    if array.size <= _SMALL and array.dtype != object:
        return _described(array.tolist(), ())
    digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:16]
    return f"{array.dtype}{list(array.shape)} {digest}"


def _function(function: types.FunctionType, above: tuple[int, ...]) -> dict[str, Any]:
    digest = hashlib.sha256(_code(function.__code__)).hexdigest()[:16]
    found: dict[str, Any] = {"function": function.__qualname__, "code": digest}
    if function.__defaults__:
        found["defaults"] = _described(function.__defaults__, above)
    if function.__closure__:
        names = function.__code__.co_freevars
        cells = [cell.cell_contents for cell in function.__closure__]
        found["closure"] = {n: _described(v, above) for n, v in zip(names, cells, strict=True)}
    if known := _globals(function, above):
        found["globals"] = known
    return found


def _globals(function: types.FunctionType, above: tuple[int, ...]) -> dict[str, Any]:
    """Values of global names that a function reads."""
    package = (function.__module__ or "").partition(".")[0]
    named = {
        name: function.__globals__[name] for name in _names(function.__code__) if name in function.__globals__
    }

    def counts(value: Any) -> bool:
        if isinstance(value, types.FunctionType):
            return (value.__module__ or "").partition(".")[0] == package
        plain = bool | int | float | str | tuple | jax.Array | np.ndarray | np.generic
        return isinstance(value, plain) or (dataclasses.is_dataclass(value) and not inspect.isclass(value))

    return {name: _described(value, above) for name, value in sorted(named.items()) if counts(value)}


def _names(code: types.CodeType) -> set[str]:
    """Names that a function looks up, inner functions included."""
    inner = [c for c in code.co_consts if isinstance(c, types.CodeType)]
    return {*code.co_names, *(name for c in inner for name in _names(c))}


def _code(code: types.CodeType) -> bytes:
    """Instructions, names and constants, without places in files."""
    constants = [_code(c) if isinstance(c, types.CodeType) else repr(c).encode() for c in code.co_consts]
    return b"|".join([code.co_code, repr(code.co_names).encode(), *constants])


def _object(value: Any, above: tuple[int, ...]) -> Any:
    cls = type(value)
    name = f"{cls.__module__}.{cls.__qualname__}"
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value)]
        return {"class": name, **{f: _described(getattr(value, f, None), above) for f in fields}}
    if inspect.isclass(value) or inspect.isbuiltin(value):
        return f"{value.__module__}.{value.__qualname__}"
    if (wrapped := getattr(value, "__wrapped__", None)) is not None:  # of jax.jit, say
        return {"class": name, "wrapped": _described(wrapped, above)}
    if hasattr(value, "__dict__") and vars(value):
        return {"class": name, **{k: _described(v, above) for k, v in vars(value).items()}}
    return name


def differences(old: Any, new: Any, name: str = "") -> list[str]:
    """What differs between two described values, a line each.

    Example:
        >>> differences({"seed": 1, "run": [1, 2]}, {"seed": 2, "run": [1, 2]})
        ['seed: stored 1, now 2']
    """
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(k for k in new if k not in old)]
        parts = [(f"{name}.{k}".lstrip("."), old.get(k), new.get(k)) for k in keys]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        parts = [(f"{name}[{i}]", a, b) for i, (a, b) in enumerate(zip(old, new, strict=True))]
    else:
        return [] if old == new else [f"{name}: stored {_short(old)}, now {_short(new)}"]
    return [line for part, a, b in parts for line in differences(a, b, part)]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
