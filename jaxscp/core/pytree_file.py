"""Pytrees in files: an .npz with one array a leaf, and a header in JSON that names classes and fields.

No code is stored, nothing is pickled, and a reader builds only the classes that it is given. Numbers are read back
bitwise. A class is known by its short name, so that it may move to another module.
"""

import dataclasses
import json
import os
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.arrays import PRECISION, double_precision
from jaxscp.core.numpy_files import DAMAGED, HEADER, replacing, why_unreadable
from jaxscp.core.status import Status, status_codes, status_names

FORMAT = 1
_STATUS = type(Status.converged)


def write(file: str | os.PathLike, parts: Mapping[str, Any]) -> None:
    """Write pytrees to a file, by name.

    Args:
        file: to write; its name stays as it is.
        parts: names, and pytrees of arrays, numbers, texts, statuses, tuples, dicts with texts for keys, and modules.

    Raises:
        TypeError: if a part holds something else, a function, say; the message names the field.
    """
    arrays: dict[str, np.ndarray] = {}
    contents = {name: _described(part, name, arrays) for name, part in parts.items()}
    header = json.dumps({"format": FORMAT, "parts": contents})
    with replacing(file) as stream:
        np.savez(stream, allow_pickle=False, **{HEADER: np.array(header)}, **arrays)


def read(file: str | os.PathLike, part: str, classes: Iterable[type]) -> Any:
    """The part of a file with this name, or None if the file holds only others.

    Args:
        file: that ``write`` wrote.
        part: its name.
        classes: that may be built.

    Raises:
        ValueError: if the file is no such file, damaged, of a newer format, or misses a field; the message names it.
        OSError: if the file cannot be read.
    """
    if not double_precision():
        raise ValueError(f"{file}: {PRECISION}")
    known = {cls.__qualname__: cls for cls in classes}
    try:
        # Opened here: NumPy leaves the file open where it is no archive.
        with open(file, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            contents = _header(archive)["parts"]
            return _Builder(archive, known).build(contents[part], part) if part in contents else None
    except _Damaged as error:
        raise ValueError(f"{file}: {error}") from error.__cause__
    except DAMAGED as error:
        raise ValueError(
            f"{file}: not a file that save wrote, or damaged: {why_unreadable(file, error)}"
        ) from error


class _Damaged(Exception):
    """Something is wrong in a file; the message names the field."""


def _header(archive: Any) -> dict[str, Any]:
    if HEADER not in archive:
        trajectory = "; a trajectory alone: jaxscp.Trajectory.load reads it" if "dilation" in archive else ""
        raise _Damaged(
            f"not a file that save wrote: it has no {HEADER!r}, but {', '.join(archive) or 'nothing'}{trajectory}"
        )
    header = json.loads(str(archive[HEADER]))
    if not isinstance(header, dict) or not isinstance(header.get("parts"), dict):
        raise _Damaged("not a file that save wrote: its header has no 'parts'")
    if not isinstance(header.get("format"), int) or header["format"] > FORMAT:
        raise _Damaged(
            f"its format is {header.get('format')}, and this version of jaxscp reads {FORMAT}; update jaxscp"
        )
    return header


def _described(tree: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """The header's description of a pytree; its leaves go into ``arrays``."""
    if isinstance(tree, _STATUS):
        arrays[name] = np.asarray(status_names(tree))
        return {"status": name}
    if isinstance(tree, eqx.Module):
        names = [field.name for field in dataclasses.fields(tree)]
        fields = {field: _described(getattr(tree, field), f"{name}.{field}", arrays) for field in names}
        return {"class": type(tree).__qualname__, "fields": fields}
    if isinstance(tree, dict) and all(isinstance(key, str) for key in tree):
        return {"entries": {key: _described(v, f"{name}.{key}", arrays) for key, v in tree.items()}}
    if isinstance(tree, tuple):
        return {"items": [_described(v, f"{name}[{i}]", arrays) for i, v in enumerate(tree)]}
    if isinstance(tree, jax.Array | np.ndarray | np.generic) and np.asarray(tree).dtype != object:
        arrays[name] = np.asarray(tree)
        return {"array": name}
    if tree is None or isinstance(tree, str | bool | int | float):
        return {"value": tree}
    raise TypeError(f"{name}: a {type(tree).__name__} cannot be saved; arrays, numbers and texts can")


class _Builder:
    """Builds pytrees from a file."""

    def __init__(self, archive: Any, known: Mapping[str, type]):
        self.archive, self.known = archive, known

    def build(self, part: Any, name: str) -> Any:
        """The pytree of a description."""
        if not isinstance(part, dict):
            raise _Damaged(f"field {name!r}: its description in the header is damaged")
        if "status" in part:
            return self._status(part["status"], name)
        if "class" in part:
            return self._module(part, name)
        if "entries" in part:
            return {key: self.build(v, f"{name}.{key}") for key, v in part["entries"].items()}
        if "items" in part:
            return tuple(self.build(v, f"{name}[{i}]") for i, v in enumerate(part["items"]))
        if "array" in part:
            return jnp.asarray(self._array(part["array"], name))
        if "value" in part:
            return part["value"]
        raise _Damaged(f"field {name!r}: its description in the header is damaged")

    def _array(self, key: str, name: str) -> np.ndarray:
        if key not in self.archive:
            raise _Damaged(f"field {name!r} is missing")
        try:
            return self.archive[key]
        except DAMAGED as error:
            raise _Damaged(f"field {name!r} is damaged: {error}") from error

    def _status(self, key: str, name: str) -> Any:
        try:
            return status_codes(self._array(key, name))
        except KeyError as error:
            raise _Damaged(f"field {name!r}: {error.args[0]}") from error

    def _module(self, part: Mapping[str, Any], name: str) -> Any:
        cls = self.known.get(part["class"])
        if cls is None:
            raise _Damaged(f"field {name!r}: the class {part['class']!r} is not expected there")
        fields = {field.name: field for field in dataclasses.fields(cls)}
        unknown = sorted(set(part["fields"]) - set(fields))
        if unknown:
            raise _Damaged(f"field {f'{name}.{unknown[0]}'!r} is unknown to this version of jaxscp")
        module = object.__new__(cls)  # no constructor: it may change numbers
        for field, about in fields.items():
            if field in part["fields"]:
                value = self.build(part["fields"][field], f"{name}.{field}")
            elif about.default is not dataclasses.MISSING:
                value = about.default  # the field is younger than the file
            else:
                raise _Damaged(f"field {f'{name}.{field}'!r} is missing")
            object.__setattr__(module, field, value)
        return module
