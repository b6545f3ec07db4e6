"""Polygon files (.ply): a cloud where there are vertices alone, a surface where there are faces or strips."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request
from jaxscp.corridor.meshes import Triangles, sampled

_LISTS = ("vertex_indices", "vertex_index")


def read_ply(path: Path, request: Request) -> FileContent:
    """Points of a .ply, ASCII or binary; faces and triangle strips are sampled as surfaces.

    Raises:
        CloudFileError: there is no vertex with x, y and z, or a face names a vertex that does not exist.
    """
    plyfile = request.library
    size = path.stat().st_size
    try:
        data = _parsed(path, plyfile)
    except plyfile.PlyParseError as error:
        raise CloudFileError(f"{path}: {error} (file of {size} bytes)") from error
    except UnicodeDecodeError as error:
        raise CloudFileError(f"{path}: byte {error.start}: not a .ply header") from error
    except (ValueError, OSError) as error:
        raise CloudFileError(f"{path}: not a whole .ply of {size} bytes: {error}") from error
    elements = {element.name.lower(): element for element in data.elements}
    if "vertex" not in elements:
        raise CloudFileError(f"{path}: no element 'vertex' among {', '.join(elements) or 'none'}")
    points = _vertices(path, elements["vertex"])
    triangles = [_fans(path, elements.get("face")), _strips(path, elements.get("tristrips"))]
    indices = np.concatenate(triangles)
    if not len(indices):
        return FileContent(points)
    if indices.min() < 0 or indices.max() >= len(points):
        raise CloudFileError(f"{path}: a face names vertex {indices.max()}, but there are {len(points)}")
    finite = np.isfinite(points).all(axis=1)[indices].all(axis=1)
    if not finite.any():
        raise CloudFileError(f"{path}: no triangle with finite corners")
    return FileContent(sampled(path, points.astype(float), indices[finite], request))


def _parsed(path: Path, plyfile: Any) -> Any:
    """Binary triangles are read at once where every face is one; other faces one by one."""
    try:
        return plyfile.PlyData.read(str(path), known_list_len={"face": dict.fromkeys(_LISTS, 3)}, mmap="c")
    except (plyfile.PlyParseError, ValueError, KeyError):
        return plyfile.PlyData.read(str(path))


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
    triangles = []
    for size in np.unique(sizes[sizes >= 3]):
        polygons = np.stack([lists[k] for k in np.flatnonzero(sizes == size)]).astype(int)
        triangles += [polygons[:, [0, k, k + 1]] for k in range(1, size - 1)]
    return np.concatenate(triangles) if triangles else np.empty((0, 3), int)


def _strips(path: Path, element: Any) -> Triangles:
    """Triangles of strips; a negative number ends a strip, and triangles without area are left out."""
    lists = _index_lists(path, element)
    if lists is None:
        return np.empty((0, 3), int)
    windows = [np.lib.stride_tricks.sliding_window_view(s.astype(int), 3) for s in lists if len(s) >= 3]
    triangles = np.concatenate(windows) if windows else np.empty((0, 3), int)
    return triangles[(triangles >= 0).all(axis=1)]
