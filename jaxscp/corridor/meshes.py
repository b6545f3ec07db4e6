"""Meshes that trimesh reads: .stl, .glb and .gltf."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request
from jaxscp.corridor.surfaces import Surface, surface_content

_STL_HEAD, _STL_RECORD = 84, 50
_FACET = re.compile(rb"^\s*facet\b", re.IGNORECASE | re.MULTILINE)
_END_FACET = re.compile(rb"^\s*endfacet\b", re.IGNORECASE | re.MULTILINE)
_END_SOLID = re.compile(rb"^\s*endsolid\b", re.IGNORECASE | re.MULTILINE)


def read_stl(path: Path, request: Request) -> FileContent:
    """Samples of the surface of a .stl, text or binary.

    Raises:
        CloudFileError: the number of triangles is not as the file says, or none has finite corners.
    """
    stated = _stated_triangles(path)
    surface = _trimesh_surface(path, request.library)
    if len(surface.triangles) != stated:
        raise CloudFileError(
            f"{path}: states {stated} triangles, but {len(surface.triangles)} can be read: damaged?"
        )
    if not stated:
        raise CloudFileError(f"{path}: holds no triangle")
    return surface_content(path, surface, request)


def read_gltf(path: Path, request: Request) -> FileContent:
    """Samples of the surfaces of a .glb or .gltf, its points, and the ends of its lines.

    Raises:
        CloudFileError: there is neither a point nor a triangle with finite corners.
    """
    surface = _trimesh_surface(path, request.library)
    if not len(surface.corners):
        raise CloudFileError(f"{path}: holds no triangle, line or point")
    content = surface_content(path, surface, request)
    doubt = (
        "glTF is y up by its standard, but some programs write it z up. State it: frame='y-up' or frame='enu' "
        "(--frame)"
    )
    return content._replace(unit="m", doubts=(doubt,))


def _trimesh_surface(path: Path, trimesh: Any) -> Surface:
    """Everything of a scene; trimesh would drop corners that are not finite, and all that is no triangle."""
    try:
        parts = trimesh.load_scene(str(path), file_type=path.suffix.lower()[1:], process=False).dump()
        surfaces = [_surface_of(part) for part in parts]
    except Exception as error:  # its loaders raise whatever their parsers raise
        raise CloudFileError(f"{path}: not a mesh of {path.stat().st_size} bytes: {error}") from error
    surfaces.append(Surface(np.empty((0, 3)), np.empty((0, 3), int)))
    sizes = np.array([len(surface.corners) for surface in surfaces])
    numbered = list(zip(surfaces, np.cumsum(sizes) - sizes, strict=True))
    return Surface(
        np.concatenate([surface.corners for surface in surfaces]),
        np.concatenate([surface.triangles + first for surface, first in numbered]),
    )


def _surface_of(part: Any) -> Surface:
    """Vertices and triangles of one geometry of trimesh; ends of lines are vertices alone."""
    corners = np.asarray(part.vertices, float).reshape(-1, 3)
    if hasattr(part, "faces"):
        # Parts share vertices in glTF: those that this part does not name belong to another, elsewhere.
        used, numbers = np.unique(np.asarray(part.faces), return_inverse=True)
        return Surface(corners[used], numbers.reshape(-1, 3).astype(int))
    # Trimesh joins the ends of lines of glTF in the order of the file, whatever its indices say.
    return Surface(corners, np.empty((0, 3), int))


def _stated_triangles(path: Path) -> int:
    """Triangles that a .stl says it has: by its header, or by its facets in text.

    Raises:
        CloudFileError: the file holds another number.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(1000)
        stated = int.from_bytes(head[80:84], "little")
        needed = _STL_HEAD + _STL_RECORD * stated
        if size >= _STL_HEAD and size == needed:
            return stated
        data = head + file.read() if head.lstrip().lower().startswith(b"solid") else b""
    if _FACET.search(data) or _END_SOLID.search(data):
        return _stated_facets(path, data)
    if size < _STL_HEAD:
        raise CloudFileError(
            f"{path}: {size} bytes are too few for a .stl, whose header alone takes {_STL_HEAD}"
        )
    cause = "cut off, or not a .stl" if size < needed else "a wrong count, or bytes were added"
    raise CloudFileError(
        f"{path}: the header states {stated} triangles, which need {needed} bytes, but the file has {size} bytes, "
        f"room for {(size - _STL_HEAD) // _STL_RECORD}: {cause}"
    )


def _stated_facets(path: Path, data: bytes) -> int:
    begun, ended = len(_FACET.findall(data)), len(_END_FACET.findall(data))
    ends = [match.start() for match in _END_FACET.finditer(data)]
    closed = [match.start() for match in _END_SOLID.finditer(data)]
    if begun != ended:
        raise CloudFileError(f"{path}: {begun} facets begin, but {ended} end: cut off, or damaged")
    if not closed or (ends and closed[-1] < ends[-1]):
        raise CloudFileError(f"{path}: no endsolid after the last of its {ended} facets: cut off?")
    return ended
