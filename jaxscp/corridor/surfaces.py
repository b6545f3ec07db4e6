"""Surfaces as points: samples of triangles and lines, and the vertices that belong to none."""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request

_SAMPLES_PER_CELL = 8
_MOST_SAMPLES = 20_000_000

Corners = Float[np.ndarray, "corners 3"]
Triangles = Int[np.ndarray, "triangles 3"]
Segments = Int[np.ndarray, "segments 2"]
Flags = Bool[np.ndarray, "_"]
Numbers = Int[np.ndarray, "_"]
_NO_SEGMENTS = np.empty((0, 2), int)


class Surface(NamedTuple):
    """Vertices of a file, and the triangles and lines between them."""

    corners: Corners
    """Positions of the vertices in the file's unit; they may be NaN."""
    triangles: Triangles
    """Vertex numbers from 0."""
    segments: Segments = _NO_SEGMENTS
    """Vertex numbers of both ends."""
    first: int = 0
    """Number that the file gives its first vertex, for messages."""


def fans(flat: Numbers, sizes: Numbers) -> Triangles:
    """Triangles of polygons, each as a fan about its first corner, which covers it even where it is not convex.

    Args:
        flat: vertex numbers of all polygons, one polygon after the other.
        sizes: corners of each polygon; with fewer than three there is no triangle.

    Example:
        >>> fans(np.arange(4), np.array([4])).tolist()
        [[0, 1, 2], [0, 2, 3]]
    """
    first = np.cumsum(sizes) - sizes
    triangles = []
    for size in np.unique(sizes[sizes >= 3]):
        polygons = flat[first[sizes == size][:, None] + np.arange(size)]
        triangles += [polygons[:, [0, k, k + 1]] for k in range(1, size - 1)]
    return np.concatenate(triangles) if triangles else np.empty((0, 3), int)


def surface_content(path: Path, surface: Surface, request: Request, merge: bool = True) -> FileContent:
    """Samples of triangles and lines, and vertices of neither as points; a cloud where there are vertices alone.

    Args:
        path: the file, for messages.
        surface: content of the file.
        request: options of the reader.
        merge: whether corners of triangles at one place become one, so that no edge is sampled twice.

    Raises:
        CloudFileError: a number names no vertex, no corner is finite, or the surface is too large for its spacing.
        ValueError: the spacing is not positive.
    """
    corners, triangles, segments, _ = surface
    if not len(triangles) and not len(segments):
        return FileContent(corners)
    if not request.spacing > 0:
        raise ValueError(f"spacing must be positive, got {request.spacing}")
    _check_numbers(path, "face", triangles, surface)
    _check_numbers(path, "line", segments, surface)
    finite = np.asarray(np.isfinite(corners).all(axis=1))
    triangles = _finite_ones(path, "faces", triangles, finite)
    segments = _finite_ones(path, "lines", segments, finite)
    if not len(triangles) and not len(segments):
        raise CloudFileError(
            f"{path}: no triangle or line with finite corners among its {len(corners)} vertices"
        )
    _warn_of_unnamed(path, ~_named(surface), finite)
    loose = corners[finite & ~_named(Surface(corners, triangles, segments))]
    points = [_sampled(path, *_merged(corners, triangles, request, merge), request)] if len(triangles) else []
    points += _line_points(path, corners, segments, request)
    notes = (f"{len(loose)} vertices of no face are kept as points",) if len(loose) else ()
    return FileContent(np.concatenate([*points, loose]), notes=notes)


def _check_numbers(path: Path, kind: str, numbers: Int[np.ndarray, "_ _"], surface: Surface) -> None:
    count, first = len(surface.corners), surface.first
    wrong = numbers[(numbers < 0) | (numbers >= count)]
    if len(wrong):
        raise CloudFileError(
            f"{path}: a {kind} names vertex {wrong[0] + first}, but there are {count}, counted from {first}: cut off?"
        )


def _finite_ones(path: Path, kind: str, numbers: Int[np.ndarray, "_ n"], finite: Flags) -> np.ndarray:
    """Faces or lines whose corners are all finite; a warning tells how many are not."""
    keep = np.asarray(finite[numbers].all(axis=1))
    dropped = int(len(keep) - np.count_nonzero(keep))
    if dropped:
        warnings.warn(f"{path}: dropped {dropped} of {len(keep)} {kind}, corners not finite", stacklevel=2)
    return numbers[keep] if dropped else numbers


def _named(surface: Surface) -> Flags:
    """Which vertices a triangle or a line names."""
    named = np.zeros(len(surface.corners), bool)
    named[surface.triangles] = True
    named[surface.segments] = True
    return named


def _warn_of_unnamed(path: Path, unnamed: Flags, finite: Flags) -> None:
    dropped = int(np.count_nonzero(unnamed & ~finite))
    if dropped:
        total = int(np.count_nonzero(unnamed))
        warnings.warn(f"{path}: dropped {dropped} of {total} vertices of no face, not finite", stacklevel=2)


def _merged(
    corners: Corners, triangles: Triangles, request: Request, merge: bool
) -> tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]]:
    """Triangles whose corners at one place are one."""
    if not merge:
        return corners, triangles
    used, numbers = np.unique(triangles, return_inverse=True)
    mesh = request.load("trimesh").Trimesh(corners[used], numbers.reshape(-1, 3), process=True)
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces)


def _sampled(
    path: Path, corners: Corners, triangles: Triangles, request: Request
) -> Float[np.ndarray, "points 3"]:
    """Random samples of triangles, eight for each square of side ``spacing``, their corners, and their long edges.

    Holes wider than the spacing are unlikely, and none is in an edge.

    Raises:
        CloudFileError: that takes too many samples; likely the mesh is not in metres.
    """
    spacing = request.spacing
    sides = corners[triangles]
    area = 0.5 * float(
        np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum()
    )
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    lengths = _lengths(corners, edges)
    samples = int(np.ceil(_SAMPLES_PER_CELL * area / spacing**2))
    if samples + lengths.sum() / spacing > _MOST_SAMPLES:
        raise _too_many(path, f"a surface of {area:.0f} square units needs {samples}", request)
    trimesh = request.load("trimesh")
    mesh = trimesh.Trimesh(corners, triangles, process=False)
    points = [corners[np.unique(triangles)], *_edge_points(corners, edges, lengths, spacing)]
    if samples:
        points.insert(0, np.asarray(trimesh.sample.sample_surface(mesh, samples, seed=request.seed)[0]))
    return np.concatenate(points)


def _edge_points(
    corners: Corners, edges: Segments, lengths: Float[np.ndarray, "_"], spacing: float
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


def _line_points(path: Path, corners: Corners, segments: Segments, request: Request) -> list[np.ndarray]:
    """Both ends of lines, and points between them no farther apart than the spacing."""
    lengths = _lengths(corners, segments)
    if lengths.sum() / request.spacing > _MOST_SAMPLES:
        raise _too_many(
            path, f"lines of {lengths.sum():.0f} units need {lengths.sum() / request.spacing:.0f}", request
        )
    return [corners[np.unique(segments)], *_edge_points(corners, segments, lengths, request.spacing)]


def _lengths(corners: Corners, segments: Segments) -> Float[np.ndarray, "_"]:
    return np.linalg.norm(corners[segments[:, 1]] - corners[segments[:, 0]], axis=1)


def _too_many(path: Path, need: str, request: Request) -> CloudFileError:
    """A larger spacing helps only where the unit is sure: with a wrong one, it would leave holes in every wall."""
    remedy = (
        "Is it in metres? State its unit: unit='mm', or unit='m' (--unit mm, --unit m)"
        if request.unit is None
        else "Cut it to the flight, or choose a larger spacing between samples: spacing=1.0 (--spacing 1)"
    )
    return CloudFileError(
        f"{path}: {need} samples every {request.spacing:g}, and {_MOST_SAMPLES} is the most. {remedy}"
    )
