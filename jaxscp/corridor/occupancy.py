"""Occupancy grids as obstacle points: occupied cells, and unknown ones that touch free ones."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from jaxscp.corridor.file_content import CloudFileError, FileContent, FileLayout

_HALF_DIAGONAL = 0.5 * float(np.sqrt(3.0))
_NEIGHBOURS = np.ones((3, 3, 3), bool)


class Voxels(NamedTuple):
    """A grid that knows which cells are occupied, and perhaps which are free."""

    occupied: Bool[np.ndarray, "x y z"]
    free: Bool[np.ndarray, "x y z"] | None
    """Cells known to be free; None where every cell that is not occupied is free."""
    corner: Float[np.ndarray, "3"]
    """Lower corner of the grid, metres."""
    cell: float
    """Edge of a cell, metres."""


class FloorPlan(NamedTuple):
    """A plan of free cells, seen from above."""

    path: Path
    free: Bool[np.ndarray, "x y"]
    corner: Float[np.ndarray, "3"]
    """Lower corner of the plan, metres."""
    cell: float
    """Edge of a cell, metres."""


def voxel_points(grid: Voxels) -> FileContent:
    """Centres of the cells that bound free space; a surface lies within half a diagonal of one of them.

    Unknown is not free. An unknown cell beside a free one is an obstacle. The outside of the grid is unknown.
    """
    if grid.free is None:
        hidden = scipy.ndimage.binary_erosion(grid.occupied, _NEIGHBOURS, border_value=1)
        bounding = grid.occupied & ~np.asarray(hidden)
        places = np.argwhere(bounding)
    else:
        free = np.pad(grid.free, 1)
        beside = np.asarray(scipy.ndimage.binary_dilation(free, _NEIGHBOURS)) & ~free
        places = np.argwhere(beside | np.pad(grid.occupied, 1)) - 1
    points = grid.corner + (places + 0.5) * grid.cell
    notes = () if grid.free is None else ("cells that the map does not know count as obstacles",)
    return FileContent(points, unit="m", cover=_HALF_DIAGONAL * grid.cell, notes=notes)


def floor_plan_points(plan: FloorPlan, layout: FileLayout) -> FileContent:
    """Walls of a floor plan, from z = 0 up to its height, with a floor and a ceiling there.

    Raises:
        CloudFileError: no height is given.
    """
    if layout.height is None or not layout.height > 0:
        raise CloudFileError(
            f"{plan.path}: a floor plan needs the height of its rooms in metres: layout=FileLayout(height=2.5) "
            "(--height 2.5)"
        )
    free = np.pad(plan.free, 1)
    beside = np.asarray(scipy.ndimage.binary_dilation(free, _NEIGHBOURS[0])) & ~free
    levels = np.linspace(0.0, layout.height, int(np.ceil(layout.height / plan.cell)) + 1)
    walls = _columns(np.argwhere(beside) - 1, levels)
    plates = _columns(np.argwhere(free) - 1, levels[[0, -1]])
    points = np.concatenate([walls, plates])
    points[:, :2] = plan.corner[:2] + (points[:, :2] + 0.5) * plan.cell
    points[:, 2] += plan.corner[2]
    note = (
        f"walls, floor and ceiling reach from z = {plan.corner[2]:g} to {plan.corner[2] + layout.height:g} m"
    )
    return FileContent(points, unit="m", frame="enu", cover=_HALF_DIAGONAL * plan.cell, notes=(note,))


def _columns(cells: np.ndarray, levels: np.ndarray) -> Float[np.ndarray, "points 3"]:
    """Every cell at every level."""
    return np.column_stack([np.repeat(cells, len(levels), axis=0).astype(float), np.tile(levels, len(cells))])
