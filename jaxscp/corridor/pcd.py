"""Point Cloud Data files (.pcd) of every version: the header is brought to version 0.7, then read by pypcd4."""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request, bytes_after, check_count
from jaxscp.corridor.tables import Dialect, read_columns

_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_TYPES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}


class Header(NamedTuple):
    """Header of a .pcd."""

    meta: Any
    """As pypcd4 has it."""
    lines: int
    """Lines in the file."""
    start: int
    """Byte at which the data begin."""


def read_pcd(path: Path, request: Request) -> FileContent:
    """Points from a .pcd: ascii, binary or binary_compressed; version 0.5 to 0.7, field names in either case.

    Raises:
        CloudFileError: the header or the data are wrong; the message has the field or the place.
    """
    header = _header(path, request.library)
    check_count(path, header.meta.points)
    points = _points(path, header, request.library)
    viewpoint = tuple(float(value) for value in header.meta.viewpoint)
    return FileContent(points, viewpoint=viewpoint if _moves(viewpoint) else None)


def _moves(viewpoint: tuple[float, ...]) -> bool:
    """Whether a sensor's pose differs from the identity; a quaternion of the other sign is the same."""
    position, attitude = np.array(viewpoint[:3]), np.array(viewpoint[3:])
    return bool(np.any(position != 0) or np.any(np.abs(attitude) != np.abs(_IDENTITY[3:])))


def _header(path: Path, pypcd4: Any) -> Header:
    lines, start = _header_lines(path)
    entries = {
        words[0].upper(): words[1:] for line in lines if (words := line.split()) and words[0][0] != "#"
    }
    fields = entries.setdefault("FIELDS", entries.pop("COLUMNS", []))
    fields[:] = [field.lower() for field in fields]
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise CloudFileError(f"{path}: no field {', '.join(missing)} among FIELDS {' '.join(fields)}")
    repeated = [axis for axis in "xyz" if fields.count(axis) > 1]
    if repeated:
        raise CloudFileError(
            f"{path}: field {', '.join(repeated)} comes twice in FIELDS {' '.join(fields)}; which one is meant?"
        )
    _check_types(path, entries, fields)
    _check_viewpoint(path, entries.setdefault("VIEWPOINT", [f"{value:g}" for value in _IDENTITY]))
    try:
        entries.setdefault("COUNT", ["1"] * len(fields))
        entries.setdefault("HEIGHT", ["1"])
        entries["VERSION"] = ["0.7"]
        entries["DATA"] = [entries["DATA"][0].lower()]
        _fill_counts(entries)
        meta = pypcd4.MetaData.parse_header([f"{key} {' '.join(words)}" for key, words in entries.items()])
    except (ValueError, KeyError, IndexError) as error:
        # An error of pydantic has many lines.
        cause = f"no {error.args[0]}" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise CloudFileError(
            f"{path}: the header, lines 1 to {len(lines)}, is not that of a .pcd: {cause}"
        ) from error
    if meta.width * meta.height != meta.points:
        raise CloudFileError(
            f"{path}: WIDTH {meta.width} times HEIGHT {meta.height} is {meta.width * meta.height}, but POINTS is "
            f"{meta.points}: mend the header"
        )
    return Header(meta, len(lines), start)


def _fill_counts(entries: dict[str, list[str]]) -> None:
    """WIDTH and POINTS where one is missing.

    Raises:
        KeyError: both are missing.
        ValueError: one is no whole number from 0, or the kind of data is unknown.
    """
    for key in ("WIDTH", "HEIGHT", "POINTS"):
        if key in entries and not (len(entries[key]) == 1 and entries[key][0].isdecimal()):
            raise ValueError(f"{key} must be a whole number from 0, has {' '.join(entries[key])!r}")
    if entries["DATA"][0] not in _ENCODINGS:
        raise ValueError(f"DATA must be {', '.join(_ENCODINGS)}, has {entries['DATA'][0]!r}")
    if "POINTS" not in entries:
        entries["POINTS"] = [str(int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0]))]
    entries.setdefault("WIDTH", entries["POINTS"])


def _check_viewpoint(path: Path, words: list[str]) -> None:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != len(_IDENTITY):
        raise CloudFileError(
            f"{path}: VIEWPOINT {' '.join(words)}: must be seven numbers, x, y, z and a quaternion (w, x, y, z)"
        )


def _header_lines(path: Path) -> tuple[list[str], int]:
    """Lines up to and with DATA, and the byte at which the data begin."""
    lines: list[str] = []
    with path.open("rb") as file:
        for raw in file:
            line = raw[:2000].decode("latin-1").strip()
            lines.append(line)
            if re.match(r"DATA\b", line, re.IGNORECASE):
                return lines, file.tell()
            if re.search(r"[\x00-\x08\x0e-\x1f]", line) or len(lines) > 100:
                break
    raise CloudFileError(f"{path}: line {max(len(lines), 1)}: not a .pcd header, no DATA line before it")


def _check_types(path: Path, entries: dict[str, list[str]], fields: list[str]) -> None:
    """Every field has a size, a type and a count that fit each other."""
    for key in ("SIZE", "TYPE", *(["COUNT"] if "COUNT" in entries else [])):
        if len(entries.get(key, [])) != len(fields):
            found = " ".join(entries.get(key, [])) or "nothing"
            raise CloudFileError(
                f"{path}: {key} must have one entry for each of FIELDS {' '.join(fields)}, has {found}"
            )
    for count in entries.get("COUNT", []):
        if not count.isdecimal() or int(count) < 1:
            raise CloudFileError(f"{path}: COUNT must hold whole numbers from 1, has {count!r}")
    entries["TYPE"] = [kind.upper() for kind in entries["TYPE"]]
    for field, kind, size in zip(fields, entries["TYPE"], entries["SIZE"], strict=True):
        if kind not in _TYPES or not size.isdigit() or int(size) not in _TYPES[kind]:
            known = ", ".join(f"{k} of {' '.join(map(str, sizes))}" for k, sizes in _TYPES.items())
            raise CloudFileError(
                f"{path}: field {field} has TYPE {kind} and SIZE {size}; known are {known} bytes"
            )


def _points(path: Path, header: Header, pypcd4: Any) -> np.ndarray:
    meta = header.meta
    places = [int(sum(meta.count[: meta.fields.index(axis)])) for axis in "xyz"]
    if meta.data.value == "ascii":
        points = read_columns(path, places, Dialect("latin-1", None, False, header.lines, None))
        if points.shape[0] != meta.points:
            raise CloudFileError(
                f"{path}: ends at line {header.lines + points.shape[0]} with {points.shape[0]} points, "
                f"the header promises {meta.points}"
            )
        return points
    _check_size(path, header)
    if meta.data.value == "binary":
        return _binary(path, header)
    try:
        with path.open("rb") as file:
            file.seek(header.start)
            packed, whole = np.frombuffer(file.read(8), "<u4")
            data = pypcd4.pypcd4.lzf.decompress(file.read(int(packed)), int(whole))
        columns = [_column(meta, axis) for axis in "xyz"]
        return np.stack(
            [np.frombuffer(data, kind, meta.points, at * meta.points) for at, kind in columns], axis=1
        )
    except (ValueError, RuntimeError, TypeError) as error:
        raise CloudFileError(
            f"{path}: the data from byte {header.start} on cannot be decoded: {error}"
        ) from error


def _column(meta: Any, axis: str) -> tuple[int, np.dtype]:
    """Bytes of a point before a field, and the field's type."""
    place = meta.fields.index(axis)
    before = sum(size * count for size, count in zip(meta.size[:place], meta.count[:place], strict=True))
    return before, np.dtype(f"<{meta.type[place].lower()}{meta.size[place]}")


def _itemsize(meta: Any) -> int:
    return sum(size * count for size, count in zip(meta.size, meta.count, strict=True))


def _binary(path: Path, header: Header) -> np.ndarray:
    """Three columns of a memory map, so that other fields are never held."""
    meta = header.meta
    (x, kind), (y, kind_y), (z, kind_z) = (_column(meta, axis) for axis in "xyz")
    layout = {
        "names": list("xyz"),
        "formats": [kind, kind_y, kind_z],
        "offsets": [x, y, z],
        "itemsize": _itemsize(meta),
    }
    if meta.points == 0:
        return np.empty((0, 3))
    rows = np.memmap(path, np.dtype(layout), "r", header.start, (meta.points,))  # pyright: ignore[reportArgumentType, reportCallIssue]
    return np.stack([rows[axis] for axis in "xyz"], axis=1)


def _check_size(path: Path, header: Header) -> None:
    size, meta = path.stat().st_size, header.meta
    needed = unpacked = meta.points * _itemsize(meta)
    if meta.data.value != "binary":
        with path.open("rb") as file:
            file.seek(header.start)
            lengths = file.read(8)
        needed = 8
        if len(lengths) == 8:
            needed += int.from_bytes(lengths[:4], "little")
            unpacked = int.from_bytes(lengths[4:], "little")
    if meta.points and size - header.start < needed:
        raise CloudFileError(
            f"{path}: truncated at byte {size}: the header promises {meta.points} points, "
            f"which end at byte {header.start + needed}"
        )
    if rest := bytes_after(path, header.start + needed):
        more = (
            f"data of {rest // _itemsize(meta)} more" if meta.data.value == "binary" else f"{rest} bytes more"
        )
        raise CloudFileError(
            f"{path}: the header promises {meta.points} points, but {more} follow: a wrong count?"
        )
    if unpacked != meta.points * _itemsize(meta):
        held = unpacked // _itemsize(meta)
        raise CloudFileError(f"{path}: the header promises {meta.points} points, but the data hold {held}")
