"""The specification of a pytree as plain data: to compare two pytrees, and to store one in a file.

A specification is made of dicts, lists, strings and numbers, which JSON holds: a class with its fields, a tuple with
its items, an array with its shape and dtype. Classes are named, never stored: ``zeros_of`` builds only given classes.
"""

import dataclasses
import importlib
import types
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.program import PACKAGE, Program, of_this_package
from jaxscp.core.status import Status

Spec = Any

_STATUS = type(Status.converged)


def spec_of(tree: Any) -> Spec:
    """Classes, fields, shapes and dtypes of a pytree whose leaves are arrays or ``jax.ShapeDtypeStruct``.

    Example:
        >>> import jaxscp
        >>> from jaxscp.aot.pytree_spec import spec_of
        >>> spec_of(jaxscp.fixed().position)
        {'shape': [3], 'dtype': 'float64'}
    """
    if isinstance(tree, _STATUS):
        return {"status": spec_of(jax.tree.leaves(tree)[0])}
    if isinstance(tree, eqx.Module):
        parts = {field.name: spec_of(getattr(tree, field.name)) for field in dataclasses.fields(tree)}
        return {"class": f"{type(tree).__module__}.{type(tree).__qualname__}", "fields": parts}
    if isinstance(tree, dict):
        return {"entries": {str(key): spec_of(item) for key, item in tree.items()}}
    if isinstance(tree, Program):
        return {"program": tree.digest}
    if isinstance(tree, types.FunctionType) and of_this_package(tree):
        return {"function": f"{tree.__module__}.{tree.__qualname__}"}
    if isinstance(tree, tuple):
        return {"items": [spec_of(item) for item in tree]}
    if tree is None or isinstance(tree, str | bool | int | float):
        return {"value": tree}
    if hasattr(tree, "shape") and hasattr(tree, "dtype"):
        return {"shape": list(tree.shape), "dtype": str(tree.dtype)}
    raise TypeError(f"a {type(tree).__name__} has no specification")


def zeros_of(spec: Spec, classes: Iterable[type]) -> Any:
    """A pytree of zeros with this specification, built by the constructors of the given classes and no other.

    Raises:
        KeyError: if the specification misses a part, or names another class.
    """
    known = {f"{cls.__module__}.{cls.__qualname__}": cls for cls in classes}

    def build(part):
        if "program" in part:
            return MissingProgram(part["program"])
        if "function" in part:
            return _function(part["function"])
        if "status" in part:
            return Status.converged
        if "class" in part:
            return known[part["class"]](**{name: build(field) for name, field in part["fields"].items()})
        if "items" in part:
            return tuple(build(item) for item in part["items"])
        if "value" in part:
            return part["value"]
        return jnp.asarray(np.zeros(part["shape"], part["dtype"]))

    return build(spec)


class MissingProgram(Program):
    """A function of which a file holds the digest alone: equal to the function, but it cannot be called."""

    def __init__(self, digest: str):
        super().__init__(None, (), (), digest)

    def __call__(self, *arguments: Any) -> jax.Array:
        """Not possible: raises an error."""
        raise ValueError(self._MISSING)

    _MISSING = (
        "the dynamics are a function of yours, which the file of this solver does not hold. To sample the trajectory, "
        "call trajectory.with_dynamics(problem.dynamics) first."
    )


def _function(name: str) -> Any:
    """A function of this package, by its name."""
    module, _, attribute = name.rpartition(".")
    if module.partition(".")[0] != PACKAGE:
        raise KeyError(name)
    return getattr(importlib.import_module(module), attribute)


def difference(expected: Spec, found: Spec, name: str = "") -> str | None:
    """First difference of two specifications, in words; None if they are equal.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> from jaxscp.aot.pytree_spec import spec_of, difference
        >>> slow, any_speed = jaxscp.flight_limits(speed=3.0), jaxscp.flight_limits()
        >>> difference(spec_of(slow), spec_of(any_speed))
        'speed: float64 of shape () expected, got None'
    """
    if expected == found:
        return None
    if "fields" in expected and expected.get("class") == found.get("class"):
        pairs = [
            (part, expected["fields"].get(part), found["fields"].get(part)) for part in expected["fields"]
        ]
    elif "items" in expected and len(expected["items"]) == len(found.get("items", ())):
        pairs = [
            (str(i), *both) for i, both in enumerate(zip(expected["items"], found["items"], strict=True))
        ]
    elif "entries" in expected and set(expected["entries"]) == set(found.get("entries", ())):
        pairs = [(key, part, found["entries"][key]) for key, part in expected["entries"].items()]
    else:
        return f"{name}: {_words(expected)} expected, got {_words(found)}"
    below = (difference(one, other, f"{name}.{part}".lstrip(".")) for part, one, other in pairs)
    return next(words for words in below if words)


def _words(part: Spec) -> str:
    if "shape" in part:
        return f"{part['dtype']} of shape {tuple(part['shape'])}"
    if "class" in part:
        return part["class"].rpartition(".")[2]
    if "entries" in part:
        return f"entries {', '.join(part['entries'])}"
    if "program" in part:
        return f"function {part['program'][:8]}"
    return f"{len(part['items'])} items" if "items" in part else str(part.get("value"))
