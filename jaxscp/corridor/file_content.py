"""Arguments and results of the readers of file formats."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Num

MOST_POINTS = 20_000_000
"""Points that a file may have: a plan takes about 130 bytes for each."""


class CloudFileError(ValueError):
    """A file that cannot be read as its suffix says; the message names the file, the place and the cause."""


NUMPY = b"\x93NUMPY"
"""First bytes of a .npy."""
_KINDS = (
    (NUMPY, "a NumPy array", (".npy",)),
    (b"PK\x03\x04", "a .zip or .npz archive", ()),
    (b"\x1f\x8b", "a file compressed by gzip", ()),
    (b"BZh", "a file compressed by bzip2", ()),
    (b"\xfd7zXZ", "a file compressed by xz", ()),
    (b"ply\n", "a .ply file", (".ply",)),
    (b"ply\r", "a .ply file", (".ply",)),
    (b"# .PCD", "a .pcd file", (".pcd",)),
    (b"# .pcd", "a .pcd file", (".pcd",)),
    (b"LASF", "a laser scan", (".las", ".laz")),
    (b"ASTM-E57", "a laser scan", (".e57",)),
    (b"glTF", "a binary glTF", (".glb",)),
    (b"# Octomap OcTree", "an OctoMap", (".ot", ".bt")),
)
"""First bytes of kinds of files, and their suffixes; those without a suffix must be unpacked."""


def check_kind(path: Path) -> None:
    """Refuse a file whose first bytes show another kind than its suffix.

    Raises:
        CloudFileError: the suffix is wrong; the message names the kind.
    """
    with path.open("rb") as file:
        head = file.read(20)
    for first, kind, suffixes in _KINDS:
        if head.startswith(first) and path.suffix.lower() not in suffixes:
            remedy = f"rename it to {' or '.join(suffixes)}" if suffixes else "unpack it first"
            raise CloudFileError(f"{path}: looks like {kind} under another name; {remedy}")


def bytes_after(path: Path, end: int) -> int:
    """Bytes of a file after a place; zero if they only pad it: some writers fill the last page with zeros."""
    with path.open("rb") as file:
        file.seek(end)
        rest = file.read()
    return len(rest) if rest.strip(b"\0 \t\r\n") else 0


def check_count(path: Path, count: int) -> None:
    """Refuse a file with more points than memory should hold, before they are read where its header has the number.

    Raises:
        CloudFileError: there are more than 20 million.
    """
    if count > MOST_POINTS:
        raise CloudFileError(
            f"{path}: {count} points, more than the {MOST_POINTS} that are read; thin them to one per 0.05 m voxel, "
            "or cut the map to the flight, with the program that wrote the file"
        )


class FileLayout(eqx.Module):
    """Facts about a file that its format does not hold.

    Example:
        >>> FileLayout(columns=("east", "north", "height")).columns
        ('east', 'north', 'height')
    """

    columns: tuple[str, str, str] | tuple[int, int, int] | None = None
    """Columns of x, y and z in a table: names in its header, or numbers from 0."""
    cell: float | None = None
    """Edge of a cell of an occupancy array (``.npy`` of bool), metres."""
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Lower corner of an occupancy array, metres."""
    height: float | None = None
    """Height of a floor plan (``.yaml``, or a flat ``.npy`` of bool) above z = 0, metres."""


class Request(NamedTuple):
    """Options of ``read_cloud`` that a reader needs."""

    library: Any
    """The format's library, or None."""
    load: Callable[[str], Any]
    """Loads another library by its name; the error names the extra that holds it."""
    spacing: float
    """Largest hole to leave in the samples of a mesh, in the file's unit."""
    seed: int
    """Seed of these samples."""
    layout: FileLayout
    """Facts that the file does not hold."""
    unit: str | None = None
    """The unit that the caller states, or None."""


class FileContent(NamedTuple):
    """Points of a file, and the facts about them that the file states."""

    points: Num[np.ndarray, "points 3"]
    """Positions in the file's unit and frame; NaN where the file has no return."""
    unit: str | None = None
    """The unit, where the format or a header states it."""
    frame: str | None = None
    """The frame, where the format or a header states it."""
    cover: float = 0.0
    """Distance from a surface to its nearest point, where the format bounds it, in the file's unit."""
    viewpoint: tuple[float, ...] | None = None
    """Sensor position and quaternion (w, x, y, z), where the file has them and they are not the identity."""
    notes: tuple[str, ...] = ()
    """Assumptions made while reading."""
    doubts: tuple[str, ...] = ()
    """Questions that the file leaves open, and that a plan must not leave open."""
