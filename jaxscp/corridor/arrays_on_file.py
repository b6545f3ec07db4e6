"""NumPy files (.npy): arrays of points, named columns, and occupancy grids."""

from pathlib import Path

import numpy as np

from jaxscp.core.numpy_files import DAMAGED
from jaxscp.corridor.columns import chosen_columns, named_columns
from jaxscp.corridor.file_content import NUMPY, CloudFileError, FileContent, Request, check_count
from jaxscp.corridor.occupancy import FloorPlan, Voxels, floor_plan_points, voxel_points

_SAMPLE = 2000


def read_npy(path: Path, request: Request) -> FileContent:
    """Points from an array (points, 3 or more), (rows, columns, 3 or more), one with names, or one of bool.

    Raises:
        CloudFileError: the shape or the type is another one; the message says how to mend it.
    """
    array, size = _mapped(path), path.stat().st_size
    end = array.offset + array.nbytes
    if size != end:
        raise CloudFileError(
            f"{path}: its array of shape {array.shape} ends at byte {end}, but the file has {size} bytes: does it hold "
            "two arrays? Save them as one"
        )
    if array.dtype == bool:
        return _occupancy(path, array, request)
    if array.dtype.names:
        flat = array.reshape(-1)
        unit, frame, columns = named_columns(path, list(array.dtype.names), request.layout)
        points = np.stack([flat[array.dtype.names[column]] for column in columns], axis=1)
        return FileContent(points, unit, frame)
    if not np.issubdtype(array.dtype, np.number) or np.issubdtype(array.dtype, np.complexfloating):
        raise CloudFileError(
            f"{path}: expected numbers of shape (points, 3), got {array.dtype} {array.shape}"
        )
    if array.ndim == 2 and array.shape[0] == 3 and array.shape[1] > 3:
        raise CloudFileError(
            f"{path}: shape {array.shape} holds x, y and z in rows; save the transpose, points.T, of shape "
            f"({array.shape[1]}, 3)"
        )
    if array.ndim not in (2, 3) or array.shape[-1] < 3:
        raise CloudFileError(
            f"{path}: expected numbers of shape (points, 3), got {array.dtype} {array.shape}"
        )
    table = array.reshape(-1, array.shape[-1])
    check_count(path, len(table))
    columns, notes = chosen_columns(str(path), np.asarray(table[:_SAMPLE], float), request.layout)
    whole = list(columns) == list(range(table.shape[1]))
    return FileContent(np.array(table if whole else table[:, columns]), notes=notes)


def _mapped(path: Path) -> np.memmap:
    """The first array of a file.

    Raises:
        CloudFileError: there is none, or it holds Python objects.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        magic = file.read(len(NUMPY))
    if magic != NUMPY:
        raise CloudFileError(
            f"{path}: its {size} bytes do not begin with the header of a .npy; how was it saved?"
        )
    try:
        return np.lib.format.open_memmap(path, mode="r")
    except (*DAMAGED, OSError) as error:
        if "Python objects" in str(error):
            raise CloudFileError(
                f"{path}: holds Python objects, not numbers; save np.array(points, float), of shape (points, 3)"
            ) from error
        raise CloudFileError(f"{path}: not a whole .npy file of {size} bytes: {error}") from error


def _occupancy(path: Path, array: np.ndarray, request: Request) -> FileContent:
    """Obstacle points of an occupancy array: axes x, y and z, or x and y of a floor plan."""
    layout = request.layout
    if layout.cell is None or not layout.cell > 0:
        raise CloudFileError(
            f"{path}: an occupancy array of shape {array.shape} needs the edge of its cells in metres: "
            "layout=FileLayout(cell=0.1) (--cell 0.1)"
        )
    corner = np.array(layout.corner)
    if array.ndim == 3:
        return voxel_points(Voxels(np.array(array), None, corner, layout.cell))
    if array.ndim == 2:
        return floor_plan_points(FloorPlan(path, ~array, corner, layout.cell), layout)
    raise CloudFileError(f"{path}: an occupancy array has two or three axes, not {array.ndim}")
