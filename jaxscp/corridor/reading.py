"""Point clouds from files: each format by its own library, then brought to metres, z up.

=========================================  =========================================================  ========
suffix                                     content                                                    library
=========================================  =========================================================  ========
``.pcd``                                   Point Cloud Data of every version and encoding             pypcd4
``.ply``                                   vertices; faces, strips and edges are sampled              plyfile
``.xyz .txt .csv .asc .pts``               x y z by a header, or in the first three columns           numpy
``.npy``                                   array (points, 3 or more), or occupancy of bool            numpy
``.stl .obj .off .glb .gltf``              mesh, sampled at about ``spacing``; its other vertices     trimesh
``.las .laz``                              laser scan; points of class noise are left out             laspy
``.e57``                                   laser scans in their common frame                          pye57
``.bt .ot``                                OctoMap; unknown cells beside free ones are obstacles      octomap
``.yaml``                                  floor plan of ROS with its image; needs a height           yaml
=========================================  =========================================================  ========

Install the libraries with ``pip install 'jaxscp[clouds]'``; the last four rows need ``jaxscp[scans]``.
"""

import warnings
from collections.abc import Callable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscp.core.extras import of_extra
from jaxscp.core.numpy_files import DAMAGED
from jaxscp.corridor.arrays_on_file import read_npy
from jaxscp.corridor.clouds import PointCloud, Provenance
from jaxscp.corridor.conventions import metres, to_z_up
from jaxscp.corridor.extent import Triple, corners
from jaxscp.corridor.file_content import (
    CloudFileError,
    FileContent,
    FileLayout,
    Request,
    check_count,
    check_kind,
)
from jaxscp.corridor.meshes import read_gltf, read_stl
from jaxscp.corridor.pcd import read_pcd
from jaxscp.corridor.ply import read_ply
from jaxscp.corridor.robot_maps import read_floor_plan, read_octomap
from jaxscp.corridor.scans import read_e57, read_las
from jaxscp.corridor.tables import read_table
from jaxscp.corridor.text_meshes import read_obj, read_off
from jaxscp.corridor.viewpoint import check_pose, from_sensor, guessed_frame

_COARSE = 0.01
"""Rounding of stored coordinates that deserves a warning, metres."""
_ABSURD = 1e8
"""Coordinates beyond this stand for a return that never came, metres."""


class Format(NamedTuple):
    """How files of one suffix are read."""

    read: Callable[[Path, Request], FileContent]
    library: str | None
    extra: str = "clouds"


_FORMATS = {
    ".pcd": Format(read_pcd, "pypcd4"),
    ".ply": Format(read_ply, "plyfile"),
    ".npy": Format(read_npy, None),
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts"), Format(read_table, None)),
    ".stl": Format(read_stl, "trimesh"),
    ".obj": Format(read_obj, "trimesh"),
    ".off": Format(read_off, "trimesh"),
    **dict.fromkeys((".glb", ".gltf"), Format(read_gltf, "trimesh")),
    **dict.fromkeys((".las", ".laz"), Format(read_las, "laspy", "scans")),
    ".e57": Format(read_e57, "pye57", "scans"),
    **dict.fromkeys((".bt", ".ot"), Format(read_octomap, "octomap", "scans")),
    ".yaml": Format(read_floor_plan, "yaml", "scans"),
}


def read_cloud(
    path: str | PathLike[str],
    *,
    spacing: float = 0.1,
    seed: int = 0,
    unit: str | None = None,
    offset: Triple | None = None,
    frame: str | None = None,
    layout: FileLayout | None = None,
) -> PointCloud:
    """Point cloud of a file in metres, z up; a mesh in any format is sampled as a surface.

    The head of this module lists the formats; the extras ``clouds`` and ``scans`` bring their libraries.

    Args:
        path: the file.
        spacing: largest hole to leave in the samples of a mesh, metres.
        seed: of the samples of a mesh.
        unit: unit of the file: m, dm, cm, mm, km, in, ft or us-ft. None takes the file's own, or assumes metres.
        offset: (3,) position of the local origin in the map, metres, z up; it is subtracted from every point.
        frame: enu or flu (z up), ned or frd (z down), or y-up. A .pcd with a VIEWPOINT takes ``sensor``
            (points are relative to it) or ``world`` (they are not). None takes the file's own, or assumes z up.
        layout: facts that the format does not hold: columns, edge of a cell, height of a floor plan.

    Raises:
        FileNotFoundError: there is no such file.
        CloudFileError: the suffix is unknown, the file is not as its suffix says, or no point of it is usable.
        ImportError: the format's library is not installed.
        ValueError: an option has an unknown value.

    Example:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "two.csv"
        >>> _ = path.write_text("id,x,y,z\\n7,0,0,1000\\n8,2000,0,1000\\n")
        >>> read_cloud(path, unit="mm").points.tolist()
        [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]]
    """
    path = Path(path)
    scale, _ = metres(unit or "m"), to_z_up(frame or "enu")
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    chosen = _FORMATS.get(path.suffix.lower())
    if chosen is None:
        raise CloudFileError(f"{path}: unknown kind of file {path.suffix!r}; known are {', '.join(_FORMATS)}")
    load = partial(_library, chosen.extra, path)
    library = None if chosen.library is None else load(chosen.library)
    request = Request(library, load, spacing / scale, seed, layout or FileLayout(), unit)
    content = _content(chosen, path, request)
    local = np.zeros(3) if offset is None else _offset(offset)
    return _in_metres(path, content, unit or content.unit, frame, local)


def _content(chosen: Format, path: Path, request: Request) -> FileContent:
    """Content of a file; an error of a library that does not name the file becomes one that does."""
    check_kind(path)
    try:
        return chosen.read(path, request)
    except (*DAMAGED, IndexError) as error:
        if str(path) in str(error):
            raise
        why = f"{type(error).__name__}: {error}"
        raise CloudFileError(f"{path}: damaged, or not what {path.suffix} says: {why}") from error


def _in_metres(
    path: Path, content: FileContent, unit: str | None, frame: str | None, local: Float[np.ndarray, "3"]
) -> PointCloud:
    """Cloud of a file's content in metres, z up, relative to a local origin."""
    check_count(path, len(content.points))
    scale = metres(unit or "m")
    points, absurd, rounding = _usable(path, content, scale)
    points, notes, known = _in_frame(path, points, content, scale, frame)
    cloud = PointCloud.of(points - local if np.any(local) else points, source=str(path))
    doubts = content.doubts if frame is None else ()
    origin = Provenance(str(path), unit, known, content.notes + notes, doubts)
    return PointCloud(cloud.points, content.cover * scale + rounding, cloud.dropped + absurd, origin)


def _library(extra: str, path: Path, name: str) -> Any:
    return of_extra(name, extra, f"reading {path.name} needs {name}")


def _usable(
    path: Path, content: FileContent, scale: float
) -> tuple[Float[np.ndarray, "points 3"], int, float]:
    """Points in metres less those absurdly far, how many these were, and the rounding of coordinates.

    Raises:
        CloudFileError: there are points, and none is left.
    """
    stored, count = content.points, content.points.shape[0]
    points = np.asarray(stored, float) * scale if scale != 1.0 else np.asarray(stored, float)
    absurd = np.empty(0, int)
    finite = np.ones(len(points), bool)
    if count and not np.all(np.abs(corners(points)) <= _ABSURD):
        with np.errstate(invalid="ignore"):
            absurd = np.flatnonzero(
                np.any(np.abs(points) > _ABSURD, axis=1) & np.isfinite(points).all(axis=1)
            )
        points = np.delete(points, absurd, axis=0)
        finite = np.isfinite(points).all(axis=1)
    if count and not finite.any():
        why = "absurdly far" if len(absurd) == count else "not finite"
        raise CloudFileError(
            f"{path}: none of its {count} points is usable ({why}), so that it holds no obstacle; is it the right file?"
        )
    if len(absurd):
        message = f"{path}: dropped {len(absurd)} of {count} points, beyond {_ABSURD:g} m"
        warnings.warn(message, stacklevel=3)
    return points, len(absurd), _rounding(path, points, stored.dtype, scale)


def _rounding(path: Path, points: np.ndarray, stored: np.dtype, scale: float) -> float:
    """Error in metres that the stored precision allows; zero below a millimetre."""
    if not np.issubdtype(stored, np.floating) or stored.itemsize >= 8:
        return 0.0
    farthest = np.array([np.nanmax(np.abs(c), initial=0.0) for c in points.T]) / scale
    steps = np.array([float(np.spacing(value)) for value in farthest.astype(stored)]) * scale
    error = 0.5 * float(np.linalg.norm(steps))
    if error > _COARSE:
        axis = int(np.argmax(steps))
        warnings.warn(
            f"{path}: {stored} holds {'xyz'[axis]} up to {farthest[axis]:.0f} in steps of {steps[axis]:.3g} m, so "
            f"that walls are off by up to {error:.2g} m, which is added to the radius. Store float64, or coordinates "
            "near the origin",
            stacklevel=4,
        )
    return error if error > 1e-3 else 0.0


def _in_frame(
    path: Path, points: np.ndarray, content: FileContent, scale: float, frame: str | None
) -> tuple[np.ndarray, tuple[str, ...], str | None]:
    """Points in the world, z up; a note on the VIEWPOINT; and the frame, where it is known.

    Raises:
        CloudFileError: the VIEWPOINT is no pose, or nothing tells whether points are relative to it.
    """
    notes: tuple[str, ...] = ()
    if content.viewpoint is not None and frame != "world":
        check_pose(path, content.viewpoint)
        pose = [value * scale for value in content.viewpoint[:3]] + list(content.viewpoint[3:])
        relative = frame
        if frame != "sensor":
            relative, note = guessed_frame(path, points, pose)
            notes = (note,)
        if relative == "sensor":
            points = from_sensor(points, pose)
    elif frame == "sensor":
        raise CloudFileError(f"{path}: has no VIEWPOINT that frame='sensor' (--frame sensor) could apply")
    known = frame or content.frame
    if known is None or np.array_equal(to_z_up(known), np.eye(3)):
        return points, notes, known
    return points @ to_z_up(known).T, notes, known


def _offset(offset: Triple) -> np.ndarray:
    value = np.asarray(offset, float)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise ValueError(f"offset must be three finite coordinates in metres, got {offset!r}")
    return value
