"""Maps of robots: OctoMap trees (.bt, .ot), and floor plans of ROS (.yaml with an image)."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request
from jaxscp.corridor.occupancy import FloorPlan, Voxels, floor_plan_points, voxel_points

_MOST_CELLS = 100_000_000


def read_octomap(path: Path, request: Request) -> FileContent:
    """Obstacle points of an OctoMap: occupied cells, and unknown ones beside free ones.

    Raises:
        CloudFileError: the file is no tree, or holds no cell, or its grid is too large.
    """
    octomap = request.library
    # The library prints its own error and returns a broken tree, so the header is checked first.
    with path.open("rb") as file:
        first = file.readline(200)
    if not first.startswith(b"# Octomap OcTree"):
        raise CloudFileError(f"{path}: not an OctoMap: its first line is {first[:40]!r}")
    try:
        name = os.fsencode(path)
        tree = octomap.OcTree(name) if path.suffix.lower() == ".bt" else octomap.OcTree.read(name)
        leaves = [
            (*leaf.getCoordinate(), leaf.getSize(), tree.isNodeOccupied(leaf)) for leaf in tree.begin_leafs()
        ]
        cell = float(tree.getResolution())
    except Exception as error:  # its classes are those of a C++ library
        raise CloudFileError(
            f"{path}: not a whole OctoMap of {path.stat().st_size} bytes: {error}"
        ) from error
    if not leaves:
        raise CloudFileError(f"{path}: an OctoMap without a single cell, of {path.stat().st_size} bytes")
    return voxel_points(_grid(path, np.array(leaves, float), cell))


def _grid(path: Path, leaves: np.ndarray, cell: float) -> Voxels:
    """Leaves of a tree, of any size, on a grid of its smallest cells."""
    low = np.rint((leaves[:, :3] - 0.5 * leaves[:, 3:4]) / cell).astype(int)
    size = np.rint(leaves[:, 3] / cell).astype(int)
    corner = low.min(axis=0)
    shape = (low + size[:, None]).max(axis=0) - corner
    if np.prod(shape.astype(float)) > _MOST_CELLS:
        raise CloudFileError(
            f"{path}: {' x '.join(map(str, shape))} cells of {cell:g} m are too many; cut the map, or prune it to "
            "larger cells"
        )
    states = np.zeros(shape, np.uint8)
    small = size == 1
    states[tuple((low[small] - corner).T)] = 1 + (leaves[small, 4] > 0)
    for begin, edge, occupied in zip(low[~small] - corner, size[~small], leaves[~small, 4] > 0, strict=True):
        states[tuple(slice(b, b + edge) for b in begin)] = 1 + occupied
    free = states == 1
    return Voxels(states == 2, free if free.any() else None, corner * cell, cell)


def read_floor_plan(path: Path, request: Request) -> FileContent:
    """Walls of a map that ROS's map_server wrote: a .yaml that names an image, as high as the layout says.

    Raises:
        CloudFileError: an entry is missing or wrong, or the image cannot be read.
    """
    facts = _facts(path, request.library)
    image = _image(path, path.parent / str(facts["image"]))
    fraction = image / 255.0 if facts.get("negate") else 1.0 - image / 255.0
    # Cells that are neither surely occupied nor surely free are unknown, and unknown is not free.
    free = fraction < float(facts.get("free_thresh", 0.196))
    x, y, yaw = (float(value) for value in facts["origin"])
    if abs(yaw) > 1e-9:
        raise CloudFileError(f"{path}: origin is turned by {yaw} rad; only maps with a yaw of 0 are read")
    # Rows of an image run down, y runs up.
    plan = FloorPlan(path, free[::-1].T, np.array([x, y, 0.0]), float(facts["resolution"]))
    return floor_plan_points(plan, request.layout)


def _facts(path: Path, yaml: Any) -> dict[str, Any]:
    try:
        facts = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CloudFileError(f"{path}: not a .yaml: {error}") from error
    missing = [key for key in ("image", "resolution", "origin") if key not in (facts or {})]
    if not isinstance(facts, dict) or missing:
        raise CloudFileError(f"{path}: not a map of ROS: no {', '.join(missing) or 'entries'} in it")
    if len(facts["origin"]) != 3 or not float(facts["resolution"]) > 0:
        raise CloudFileError(f"{path}: needs origin [x, y, yaw] and a positive resolution in metres")
    return facts


def _image(path: Path, file: Path) -> np.ndarray:
    from PIL import Image

    try:
        with Image.open(file) as image:
            return np.asarray(image.convert("L"), float)
    except (OSError, ValueError) as error:
        raise CloudFileError(f"{path}: its image {file.name} cannot be read: {error}") from error
