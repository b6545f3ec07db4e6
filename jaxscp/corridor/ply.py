"""Polygon files (.ply): a cloud where there are vertices alone, a surface where there are faces, strips or edges."""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request, bytes_after
from jaxscp.corridor.surfaces import Segments, Surface, Triangles, fans, surface_content

_HEAD = 1 << 16
_LISTS = ("vertex_indices", "vertex_index")


def read_ply(path: Path, request: Request) -> FileContent:
    """Points of a .ply, ASCII or binary; faces, triangle strips and edges are sampled, other vertices are points.

    Raises:
        CloudFileError: no vertex has x, y and z, a face names a vertex that does not exist, or the file goes on after
            the last row that its header counts.
    """
    plyfile = request.library
    size = path.stat().st_size
    try:
        data, rest = _parsed(path, plyfile)
    except plyfile.PlyParseError as error:
        raise CloudFileError(f"{path}: {error} (file of {size} bytes)") from error
    except UnicodeDecodeError as error:
        raise CloudFileError(f"{path}: byte {error.start}: not a .ply header") from error
    except (ValueError, OSError) as error:
        raise CloudFileError(f"{path}: not a whole .ply of {size} bytes: {error}") from error
    if rest:
        counts = ", ".join(f"{element.count} of {element.name!r}" for element in data.elements)
        raise CloudFileError(
            f"{path}: {rest} follow the last row that the header counts ({counts}): is a count too low?"
        )
    elements = {element.name.lower(): element for element in data.elements}
    if "vertex" not in elements:
        raise CloudFileError(f"{path}: no element 'vertex' among {', '.join(elements) or 'none'}")
    points = _vertices(path, elements["vertex"])
    for name, element in elements.items():
        if name != "vertex" and {"x", "y", "z"} <= {prop.name.lower() for prop in element.properties}:
            message = f"{path}: the {element.count} rows of element {name!r} have x, y and z, but only 'vertex' is read"
            warnings.warn(message, stacklevel=2)
    triangles = np.concatenate([_fans(path, elements.get("face")), _strips(path, elements.get("tristrips"))])
    segments = _edges(elements.get("edge"))
    if not len(triangles) and not len(segments):
        return FileContent(points)
    return surface_content(path, Surface(points.astype(float), triangles, segments), request, merge=False)


def _parsed(path: Path, plyfile: Any) -> tuple[Any, str]:
    """Content of a file, and how much follows the last row that its header counts; empty if nothing does.

    Binary triangles are read at once where every face is one; other faces one by one.
    """
    with path.open("rb") as file:
        text = re.search(rb"[\r\n]format\s+ascii\b", file.read(_HEAD)) is not None
    if text:
        with path.open(encoding="ascii") as file:
            data = plyfile.PlyData.read(file)
            rest = sum(1 for line in file if line.strip())
        return data, f"{rest} lines" if rest else ""
    try:
        return _binary(path, plyfile, {"face": dict.fromkeys(_LISTS, 3)})
    except (plyfile.PlyParseError, ValueError, KeyError):
        return _binary(path, plyfile, {})


def _binary(path: Path, plyfile: Any, known: dict[str, dict[str, int]]) -> tuple[Any, str]:
    with path.open("rb") as file:
        data = plyfile.PlyData.read(file, known_list_len=known, mmap="c")
        rest = bytes_after(path, file.tell())
    return data, f"{rest} bytes" if rest else ""


def _vertices(path: Path, vertex: Any) -> np.ndarray:
    names = {name.lower(): name for name in vertex.data.dtype.names}
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise CloudFileError(
            f"{path}: no {', '.join(missing)} among the properties {' '.join(names)} of its vertices"
        )
    return np.stack([np.asarray(vertex[names[axis]]) for axis in "xyz"], axis=1)


def _index_lists(path: Path, element: Any) -> np.ndarray | None:
    """The lists of vertex numbers of an element: an array of arrays, or a plain one of equal lists."""
    if element is None or element.count == 0:
        return None
    for name in element.data.dtype.names:
        if name.lower() in _LISTS:
            return element[name]
    raise CloudFileError(
        f"{path}: element {element.name!r} has no list vertex_indices, only {' '.join(element.data.dtype.names)}"
    )


def _fans(path: Path, face: Any) -> Triangles:
    """Triangles of polygons, each as a fan about its first corner, which covers it even where it is not convex."""
    lists = _index_lists(path, face)
    if lists is None:
        return np.empty((0, 3), int)
    if lists.dtype != object:
        return lists.astype(int)
    sizes = np.array([len(indices) for indices in lists])
    return fans(np.concatenate(list(lists)).astype(int), sizes)


def _strips(path: Path, element: Any) -> Triangles:
    """Triangles of strips; a negative number ends a strip, and triangles without area are left out."""
    lists = _index_lists(path, element)
    if lists is None:
        return np.empty((0, 3), int)
    windows = [np.lib.stride_tricks.sliding_window_view(s.astype(int), 3) for s in lists if len(s) >= 3]
    triangles = np.concatenate(windows) if windows else np.empty((0, 3), int)
    return triangles[(triangles >= 0).all(axis=1)]


def _edges(element: Any) -> Segments:
    """Pairs of vertices of an element 'edge'."""
    if element is None or not {"vertex1", "vertex2"} <= set(element.data.dtype.names):
        return np.empty((0, 2), int)
    return np.column_stack([np.asarray(element[name]).astype(int) for name in ("vertex1", "vertex2")])
