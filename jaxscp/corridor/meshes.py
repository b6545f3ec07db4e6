"""Surfaces as points: samples of a mesh, read by trimesh, or of the faces and strips of a .ply, read by plyfile."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request

_SAMPLES_PER_CELL = 8
_MOST_SAMPLES = 20_000_000
_TEXT_MESHES = (".obj", ".off")

Corners = Float[np.ndarray, "corners 3"]
Triangles = Int[np.ndarray, "triangles 3"]


def read_mesh(path: Path, request: Request) -> FileContent:
    """Samples of the surface of a .stl, .obj, .off, .glb or .gltf.

    Raises:
        CloudFileError: there is no triangle with finite corners, or the surface is too large for its spacing.
    """
    trimesh, suffix = request.library, path.suffix.lower()
    source: Any = str(path)
    if suffix in _TEXT_MESHES:
        source = io.BytesIO(_as_utf8(path.read_bytes()))
    try:
        mesh = trimesh.load_mesh(source, file_type=suffix[1:])
        corners, triangles = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    except Exception as error:  # its loaders raise whatever their parsers raise
        raise CloudFileError(f"{path}: not a mesh of {path.stat().st_size} bytes: {error}") from error
    if triangles.size == 0 or not np.isfinite(corners).all():
        raise CloudFileError(f"{path}: no triangle with finite corners in its {path.stat().st_size} bytes")
    points = sampled(path, corners, triangles, request)
    if suffix in (".glb", ".gltf"):
        doubt = (
            "glTF is y up by its standard, but some programs write it z up. State it: frame='y-up' or frame='enu' "
            "(--frame)"
        )
        return FileContent(points, unit="m", doubts=(doubt,))
    return FileContent(points)


def _as_utf8(data: bytes) -> bytes:
    """Text in UTF-8, whatever it was; comments and names in Latin-1 do not matter to a mesh."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")
    return data


def sampled(
    path: Path, corners: Corners, triangles: Triangles, request: Request
) -> Float[np.ndarray, "points 3"]:
    """Random samples of triangles, eight for each square of side ``spacing``, their corners, and their long edges.

    Holes wider than the spacing are unlikely, and none is in an edge.

    Raises:
        CloudFileError: that takes too many samples; likely the mesh is not in metres.
        ValueError: the spacing is not positive.
    """
    spacing = request.spacing
    if not spacing > 0:
        raise ValueError(f"spacing must be positive, got {spacing} m")
    sides = corners[triangles]
    area = 0.5 * float(
        np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum()
    )
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(corners[edges[:, 1]] - corners[edges[:, 0]], axis=1)
    samples = int(np.ceil(_SAMPLES_PER_CELL * area / spacing**2))
    if samples + lengths.sum() / spacing > _MOST_SAMPLES:
        raise CloudFileError(
            f"{path}: a surface of {area:.0f} square units needs {samples} samples every {spacing:g}. Is the mesh in "
            "metres? If not, state its unit: unit='mm' (--unit mm). Else choose a larger spacing between samples: "
            "spacing=1.0 (--spacing 1)"
        )
    trimesh = request.load("trimesh")
    mesh = trimesh.Trimesh(corners, triangles, process=False)
    points = [corners[np.unique(triangles)], *_edge_points(corners, edges, lengths, spacing)]
    if samples:
        points.insert(0, np.asarray(trimesh.sample.sample_surface(mesh, samples, seed=request.seed)[0]))
    return np.concatenate(points)


def _edge_points(
    corners: Corners, edges: Int[np.ndarray, "edges 2"], lengths, spacing: float
) -> list[np.ndarray]:
    """Points inside the edges that are longer than the spacing."""
    counts = np.ceil(lengths / spacing).astype(int)
    long = np.flatnonzero(counts > 1)
    if not len(long):
        return []
    edge = np.repeat(long, counts[long] - 1)
    first = np.cumsum(counts[long] - 1) - (counts[long] - 1)
    place = np.arange(len(edge)) - np.repeat(first, counts[long] - 1) + 1
    fraction = (place / counts[edge])[:, None]
    return [(1.0 - fraction) * corners[edges[edge, 0]] + fraction * corners[edges[edge, 1]]]
