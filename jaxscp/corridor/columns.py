"""Which columns of a table are x, y and z: by their names, or by how their numbers run."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxscp.corridor.file_content import CloudFileError, FileLayout

_FEWEST = 5
COUNTED = 40
"""Rows from which a column that counts is no chance, where nothing else tells."""
_STEADY = 0.7
_UNITS = r"mm|cm|dm|km|m|ft|in"

_NAMES = {
    "x": r"(\w*[_.: ])?x|p(os)?x|points?[:_. ]0|x_?(pos|coord)\w*|cartesianx|east(ing)?",
    "y": r"(\w*[_.: ])?y|p(os)?y|points?[:_. ]1|y_?(pos|coord)\w*|cartesiany|north(ing)?",
    "z": r"(\w*[_.: ])?z|p(os)?z|points?[:_. ]2|z_?(pos|coord)\w*|cartesianz|up|elev(ation)?|height|alt(itude)?",
}
_NORTH_EAST_DOWN = {"x": r"north", "y": r"east", "z": r"down"}


def named_columns(
    path: Path, header: list[str], layout: FileLayout
) -> tuple[str | None, str | None, list[int]]:
    """Unit and frame that a header states, or None, and the columns of x, y and z.

    Raises:
        CloudFileError: the header names no x, y and z, and the layout does not either; or their units differ.

    Example:
        >>> named_columns(Path("a.csv"), ["id", "X [mm]", "Y [mm]", "Z [mm]"], FileLayout())
        ('mm', None, [1, 2, 3])
    """
    names = [_name_and_unit(name)[0] for name in header]
    if layout.columns is not None:
        columns = [c if isinstance(c, int) else _column(path, names, c.lower()) for c in layout.columns]
        if max(columns) >= len(names):
            raise CloudFileError(f"{path}: no column {max(columns)} among {len(names)} (counted from 0)")
        return _one_unit(path, header, columns), None, columns
    for patterns, frame in ((_NORTH_EAST_DOWN, "ned"), (_NAMES, None)):
        found = [_matching(names, patterns[axis]) for axis in "xyz"]
        if all(found):
            columns = [places[0] for places in found]
            return _one_unit(path, header, columns), frame, columns
    geographic = any(re.match(r"lat|lon", name) for name in names)
    hint = (
        "degrees are no metres: project them first" if geographic else "name them: columns=(...) (--columns)"
    )
    raise CloudFileError(f"{path}: no columns x, y and z in its header {' '.join(header)!r}; {hint}")


def has_names(header: list[str]) -> bool:
    """Whether a header names x, y and z.

    Example:
        >>> has_names(["X", "Y", "Z", "R"]), has_names(["made", "by", "Jay"])
        (True, False)
    """
    names = [_name_and_unit(name)[0] for name in header]
    return any(all(_matching(names, p[axis]) for axis in "xyz") for p in (_NORTH_EAST_DOWN, _NAMES))


def counts_points(column: Float[np.ndarray, "rows"]) -> bool:
    """Whether a column is the number of each point, from 0 or 1.

    Example:
        >>> counts_points(np.arange(1.0, 60.0)), counts_points(np.linspace(0.0, 1.0, 60))
        (True, False)
    """
    return (
        column[0] in (0.0, 1.0)
        and bool(column[1] - column[0] == 1.0)
        and bool(np.all(np.diff(column) == 1.0))
    )


def chosen_columns(
    source: str, rows: Float[np.ndarray, "rows columns"], layout: FileLayout
) -> tuple[list[int], tuple[str, ...]]:
    """Columns of x, y and z in a table without names, and a note where these are not the first three.

    A column that counts is the number of a point, and x follows it.

    Raises:
        CloudFileError: the first column is a time or a number, as far as one can tell, or a colour.

    Example:
        >>> counted = np.column_stack([np.arange(9), np.zeros((9, 3))])
        >>> chosen_columns("a.txt", counted, FileLayout())
        ([1, 2, 3], ('the first column counts points; x y z are columns 2 to 4',))
    """
    if layout.columns is not None:
        return _numbered(source, rows.shape[1] if rows.size else None, layout.columns), ()
    if rows.shape[0] < _FEWEST or rows.shape[1] < 4:
        return [0, 1, 2], ()
    first = rows[:, 0]
    steps = np.diff(first)
    if counts_points(first):
        return [1, 2, 3], ("the first column counts points; x y z are columns 2 to 4",)
    if np.all(steps > 0) and (_whole(first) or np.std(steps) < _STEADY * np.mean(steps)):
        raise CloudFileError(
            f"{source}: the first of {rows.shape[1]} columns rises from {first[0]:g} in every row: a number or a "
            "time rather than x? Say which columns are x, y and z: columns=(1, 2, 3) (--columns 1 2 3), counted "
            "from 0"
        )
    colour = rows[:, :3]
    if (
        rows.shape[1] >= 6
        and _whole(colour)
        and np.all((colour >= 0) & (colour <= 255))
        and not _whole(rows[:, 3:6])
    ):
        raise CloudFileError(
            f"{source}: the first three of {rows.shape[1]} columns are whole numbers from 0 to 255: a colour rather "
            "than a position? Say which columns are x, y and z: columns=(3, 4, 5) (--columns 3 4 5), "
            "counted from 0"
        )
    return [0, 1, 2], ()


def _numbered(source: str, width: int | None, columns: Sequence[str | int]) -> list[int]:
    """Columns of a table without names, checked against its width if that is known."""
    named = [column for column in columns if not isinstance(column, int)]
    if named:
        raise CloudFileError(
            f"{source}: no header names its columns, such as {named[0]!r}; give numbers, counted from 0: "
            "columns=(0, 1, 2) (--columns 0 1 2)"
        )
    numbers = [int(column) for column in columns]
    if width is not None and max(numbers) >= width:
        raise CloudFileError(f"{source}: no column {max(numbers)} among {width} (counted from 0)")
    return numbers


def _name_and_unit(name: str) -> tuple[str, str | None]:
    name = name.strip().strip("\"'").lower()
    found = re.fullmatch(rf"(.*?)\s*(?:[\[(]\s*({_UNITS})\s*[\])]|_({_UNITS}))", name)
    return (found[1].strip(), found[2] or found[3]) if found else (name, None)


def _one_unit(path: Path, header: list[str], columns: list[int]) -> str | None:
    """Unit of three columns, or None; one without a unit is in metres where another has one."""
    units = [_name_and_unit(header[column])[1] for column in columns]
    if len({unit or "m" for unit in units}) > 1:
        stated = ", ".join(header[column] for column in columns)
        raise CloudFileError(
            f"{path}: columns {stated} have different units; bring them to one, and state it for each"
        )
    return next((unit for unit in units if unit), None)


def _matching(names: list[str], pattern: str) -> list[int]:
    return [place for place, name in enumerate(names) if re.fullmatch(pattern, name)]


def _column(path: Path, names: list[str], name: str) -> int:
    if name not in names:
        raise CloudFileError(f"{path}: no column {name!r} among {' '.join(names)}")
    return names.index(name)


def _whole(numbers: np.ndarray) -> bool:
    return bool(np.all(numbers == np.round(numbers)))
