"""Identity of a sweep, as plain data: two sweeps may share a folder only if theirs are equal."""

import dataclasses
import functools
import hashlib
import inspect
import json
import sys
import types
import weakref
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from jaxscp.monte_carlo import bytecode

UNKNOWN = "content unknown"
"""Key of the class of an object whose content cannot be compared."""
_SMALL = 16  # numbers of an array that are listed, so that a difference says what changed
_SHORT = 50  # parts of an object that is described again wherever it is found again
_LONG = 200  # letters of a string that is listed
_DEEPEST = 100  # levels, each of up to 30 calls
_MOST = 200_000  # parts of a study
_WHOLE = "the whole"
_GENERATOR = np.random.normal.__self__  # NumPy's own: its state changes with every use


def described(value: Any) -> Any:
    """Plain data (for JSON) that two values share only if they mean the same.

    Functions and classes of the study are compared by their code, defaults, closures, and the globals and modules that
    they name. Modules, functions and classes of installed packages are compared by name and version. All other objects
    are compared by their fields, or as pickle would store them. ``unknown`` finds those that have no such content.

    Example:
        >>> described({"mass": 1.0, "times": (1, 2)})
        {'mass': 1.0, 'times': [1, 2]}
        >>> described(lambda x: x + 1) == described(lambda x: x + 2)
        False
    """
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(limit + 30 * _DEEPEST)
    try:
        return _Describer().of(value, "")
    finally:
        sys.setrecursionlimit(limit)


def unknown(found: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Places and kinds of the objects in described data whose content cannot be compared.

    Example:
        >>> import threading
        >>> list(unknown(described({"lock": threading.Lock()})))
        [('lock', '_thread.lock')]
    """
    if isinstance(found, dict):
        if UNKNOWN in found:
            yield place or _WHOLE, str(found[UNKNOWN])
        for name, part in found.items():
            yield from unknown(part, f"{place}.{name}".lstrip("."))
    elif isinstance(found, list):
        for i, part in enumerate(found):
            yield from unknown(part, f"{place}[{i}]")


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _digest(text: str | bytes) -> str:
    data = text if isinstance(text, bytes) else text.encode("utf-8", "replace")
    return hashlib.sha256(data).hexdigest()[:16]


class _Describer:
    """Describes objects once each, so that circles end."""

    def __init__(self, depth: int = 0):
        self.depth, self.count = depth, 0
        self.places: dict[Any, tuple[str, Any, int]] = {}
        self.alive: list[Any] = []  # numbers of objects stay unique while these live

    def of(self, value: Any, place: str, names: frozenset[str] | None = None) -> Any:
        """Plain data of a value.

        Args:
            value: any.
            place: where it was found.
            names: attributes that are read of a module.
        """
        self.count += 1
        if value is None or isinstance(value, bool | int):
            return value
        if isinstance(value, float):
            return value if np.isfinite(value) else repr(value)
        if isinstance(value, str):
            return value if len(value) <= _LONG else f"{value[:40]}... {_digest(value)}"
        key = (id(value), names if isinstance(value, types.ModuleType) else None)
        if key in self.places:
            first, content, size = self.places[key]
            if content is None or size > _SHORT:
                return {"as at": first}
            self.count += size
            return content
        if self.depth >= _DEEPEST or self.count > _MOST:
            return {UNKNOWN: f"{_name(type(value))} (too deep or too large)"}
        self.places[key] = place or _WHOLE, None, 0
        self.alive.append(value)
        self.depth, before = self.depth + 1, self.count
        content = self._content(value, place, names)
        self.depth -= 1
        self.places[key] = place or _WHOLE, content, self.count - before
        return content

    def _content(self, value: Any, place: str, names: frozenset[str] | None) -> Any:
        if isinstance(value, types.ModuleType):
            return self._module(value, place, names)
        if isinstance(value, type):
            return self._class(value, place)
        if isinstance(value, jax.Array | np.ndarray | np.generic):
            return self._array(value, place)
        kind = _KINDS.get(type(value))
        return self._object(value, place) if kind is None else kind(self, value, place)

    def _all(self, values: dict[str, Any], place: str) -> dict[str, Any]:
        return {name: self.of(value, f"{place}.{name}".lstrip(".")) for name, value in values.items()}

    def _list(self, values: Any, place: str) -> Any:
        if len(values) > _SMALL and all(type(v) in (bool, int, float) for v in values):
            return f"{len(values)} numbers {_digest(json.dumps(list(values)))}"
        return [self.of(v, f"{place}[{i}]") for i, v in enumerate(values)]

    def _dict(self, values: Any, place: str) -> Any:
        if all(isinstance(key, str) for key in values):
            return self._all(dict(values), place)
        return self._all({"items": list(map(list, values.items()))}, place)

    def _set(self, values: Any, place: str) -> Any:
        parts = [_Describer(self.depth).of(v, place) for v in values]  # no part depends on the order
        return {"set": sorted(parts, key=lambda part: json.dumps(part, sort_keys=True))}

    def _array(self, value: Any, place: str) -> Any:
        kind = str(value.dtype)
        if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
            value = jax.random.key_data(value)
        array = np.asarray(value)
        if array.size <= _SMALL or array.dtype.hasobject:
            content = self.of(array.tolist(), place)
            return content if kind == "float64" and array.size else {f"{kind}{list(array.shape)}": content}
        return f"{kind}{list(array.shape)} {_digest(np.ascontiguousarray(array).tobytes())}"

    def _module(self, module: types.ModuleType, place: str, names: frozenset[str] | None) -> Any:
        if bytecode.is_library(module.__name__):
            return {"module": module.__name__, "version": bytecode.version(module.__name__)}
        if names is None:  # nobody knows what is read of it
            try:
                return {"module": module.__name__, "source": _digest(inspect.getsource(module))}
            except (OSError, TypeError):
                return {UNKNOWN: f"module {module.__name__}"}
        found = {n: getattr(module, n) for n in sorted(names) if n[:2] != "__" and hasattr(module, n)}
        parts = {n: self.of(v, f"{place}.{n}".lstrip("."), names) for n, v in found.items()}
        return {"module": module.__name__, **parts}

    def _class(self, cls: type, place: str) -> Any:
        if bytecode.is_library(cls.__module__):
            return bytecode.with_version(_name(cls), cls.__module__)
        methods = [m for v in vars(cls).values() if (m := bytecode.function_in(v)) is not None]
        own = set().union(*(bytecode.assigned_attributes(m.__code__, cls.__name__) for m in methods))
        parts = {
            name: value
            for name, value in sorted(vars(cls).items())
            if name not in own | {"_abc_impl"}
            and (name[:2] != "__" or bytecode.function_in(value) is not None)
        }
        bases = [self.of(base, f"{place}.base") for base in cls.__bases__ if base is not object]
        return {"name": _name(cls), **({"bases": bases} if bases else {}), **self._all(parts, place)}

    def _function(self, function: types.FunctionType, place: str) -> Any:
        if getattr(function, "__beartype_wrapper", False):  # it has numbers of objects in its code
            return self.of(vars(function)["__wrapped__"], place)
        if (known := bytecode.named_in_library(function, function.__qualname__)) is not None:
            return known
        module, code = function.__globals__.get("__name__", ""), function.__code__
        own = not bytecode.is_library(module)
        name = function.__qualname__ if own else bytecode.with_version(_name(function), module)
        reads = bytecode.all_names(code)
        parts = {"defaults": function.__defaults__, "keyword_defaults": function.__kwdefaults__}
        found: dict[str, Any] = {"function": name, "code": _digest(bytecode.text_of(code, described))}
        found |= {key: self.of(value, f"{place}.{key}".lstrip(".")) for key, value in parts.items() if value}
        parts = {"closure": bytecode.closure(function), "attributes": vars(function)}
        if own:
            parts["globals"] = bytecode.globals_read(function)
            parts["imports"] = bytecode.modules_imported(function)
        for key, values in parts.items():
            if values:
                at = f"{place}.{key}".lstrip(".")
                found[key] = {n: self.of(v, f"{at}.{n}", reads) for n, v in sorted(values.items())}
        return found

    def _method(self, method: Any, place: str) -> Any:
        return self._all({"method": method.__func__, "of": method.__self__}, place)

    def _reference(self, reference: Any, place: str) -> Any:
        function = reference()
        known = isinstance(function, types.FunctionType)  # other things are in caches, which change
        return self.of(function, place) if known else {UNKNOWN: _name(type(reference))}

    def _builtin(self, function: Any, place: str) -> Any:
        if (owner := function.__self__) is None or isinstance(owner, types.ModuleType | type):
            return f"{function.__module__}.{function.__qualname__}"
        return {"method": function.__name__, "of": self.of(owner, f"{place}.of".lstrip("."))}

    def _object(self, value: Any, place: str) -> Any:
        if value is _GENERATOR:
            return "numpy.random"
        cls = type(value)
        about = self._all({"class": cls}, place)
        if dataclasses.is_dataclass(value):
            fields = {f.name: getattr(value, f.name, None) for f in dataclasses.fields(value)}
            return about | self._all(fields | bytecode.state_of(cls, getattr(value, "__dict__", {})), place)
        if "__wrapped__" in (attributes := getattr(value, "__dict__", {})):  # of jax.jit, say
            parts = {n: v for n, v in attributes.items() if n[:1] != "_" or n == "__wrapped__"}
            return about | self._all({n.strip("_"): v for n, v in parts.items()}, place)
        try:
            reduced = bytecode.reduced(value)
        except Exception:  # of an object that has no content that Python sees; any error
            return {UNKNOWN: _name(cls)}
        if isinstance(reduced, str):
            return bytecode.named_in_library(value, reduced) or {UNKNOWN: _name(cls)}
        return about | self._reduced(cls, reduced, place)

    def _reduced(self, cls: type, reduced: Any, place: str) -> dict[str, Any]:
        """What pickle would store."""
        make, arguments, state, items, entries = (*reduced, *[None] * 5)[:5]
        arguments = tuple(arguments or ())
        if arguments[:1] == (cls,):
            arguments = arguments[1:]
        parts: dict[str, Any] = {} if make in (cls, _NEW) else {"made by": make}
        if arguments:
            parts["arguments"] = arguments
        if isinstance(state, dict):
            parts |= bytecode.state_of(cls, state)
        elif state is not None:
            parts["state"] = state
        parts |= {"items": list(items)} if items is not None else {}
        parts |= {"entries": [list(entry) for entry in entries]} if entries is not None else {}
        return self._all(parts, place)


# Attributes that types written in C have.
_OF_TYPES = types.GetSetDescriptorType, types.MemberDescriptorType, types.MethodDescriptorType
_OF_TYPES = *_OF_TYPES, types.ClassMethodDescriptorType, types.WrapperDescriptorType
_NEW = object().__reduce_ex__(4)[0]
_KINDS: dict[type, Any] = {
    dict: _Describer._dict,
    types.MappingProxyType: _Describer._dict,
    list: _Describer._list,
    tuple: _Describer._list,
    set: _Describer._set,
    frozenset: _Describer._set,
    bytes: lambda self, value, place: {"bytes": value.hex() if len(value) <= _SMALL else _digest(value)},
    types.FunctionType: _Describer._function,
    types.MethodType: _Describer._method,
    types.BuiltinFunctionType: _Describer._builtin,
    weakref.ref: _Describer._reference,
    types.CodeType: lambda self, value, place: {"code": _digest(bytecode.text_of(value, described))},
    property: lambda self, value, place: self._list([value.fget, value.fset, value.fdel], place),
    staticmethod: lambda self, value, place: {"static": self.of(value.__func__, place)},
    classmethod: lambda self, value, place: {"of class": self.of(value.__func__, place)},
    functools.cached_property: lambda self, value, place: {"cached": self.of(value.func, place)},
    **dict.fromkeys(_OF_TYPES, lambda self, value, place: f"{_name(value.__objclass__)}.{value.__name__}"),
}


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
        why = "jaxscp's own source changed: " if name == "versions.code" else ""
        return [] if old == new else [f"{name}: {why}stored {_short(old)}, now {_short(new)}"]
    return [line for part, a, b in parts for line in differences(a, b, part)]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
