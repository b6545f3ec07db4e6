"""Options of the commands that read a map: what its file means, where the flight begins and ends, and its limits."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxscp.corridor.build import CorridorOptions
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.conventions import FRAMES, UNITS
from jaxscp.corridor.file_content import FileLayout
from jaxscp.corridor.gaps import with_closed_gaps
from jaxscp.corridor.map_report import MapReport, map_report
from jaxscp.corridor.reading import read_cloud

RADIUS = 0.25
"""Distance to keep from points unless one is given, metres."""

Place = tuple[float, float, float]

_FILE = "What the map's file means"
_FLIGHT = "Flight through a map"


def one_of(table: dict[str, Any]) -> str:
    """The names in a table, for help texts."""
    return f"One of: {', '.join(table)}."


def known(table: dict[str, Any], kind: str) -> Callable[[str | None], str | None]:
    """Check of an option whose value must be a name in a table."""

    def check(name: str | None) -> str | None:
        if name is not None and name not in table:
            raise typer.BadParameter(f"no {kind} is called {name!r}; choose from {', '.join(table)}")
        return name

    return check


def finite(value: Any) -> Any:
    """Check of an option that takes numbers: none may be infinite or NaN."""
    numbers = value if isinstance(value, tuple) else (value,)
    if not all(number is None or math.isfinite(number) for number in numbers):
        raise typer.BadParameter(f"needs finite numbers, got {' '.join(map(str, numbers))}")
    return value


def positive(value: float | None) -> float | None:
    """Check of an option that takes a positive number."""
    if value is not None and not finite(value) > 0:
        raise typer.BadParameter(f"must be positive, got {value:g}")
    return value


def _place(meaning: str, panel: str) -> Any:
    return typer.Option(help=f"{meaning}, m.", metavar="X Y Z", callback=finite, rich_help_panel=panel)


def _length(meaning: str, panel: str, **rules: Any) -> Any:
    return typer.Option(help=f"{meaning}, m.", metavar="LENGTH", rich_help_panel=panel, **rules)


_UNIT = typer.Option(callback=known(UNITS, "unit"), metavar="NAME", help=one_of(UNITS), rich_help_panel=_FILE)
_FRAME = typer.Option(
    callback=known(FRAMES, "frame"),
    metavar="NAME",
    help=f"{one_of(FRAMES)} For a .pcd with a VIEWPOINT: sensor, if it must be applied, or world.",
    rich_help_panel=_FILE,
)
_COLUMNS = typer.Option(
    metavar="X Y Z", help="Columns of a table: names in its header, or numbers from 0.", rich_help_panel=_FILE
)


@dataclasses.dataclass
class MapOptions:
    """Options of every command that reads a map."""

    unit: Annotated[str | None, _UNIT] = None
    frame: Annotated[str | None, _FRAME] = None
    offset: Annotated[Place | None, _place("Where the local origin lies in the map", _FILE)] = None
    columns: Annotated[tuple[str, str, str] | None, _COLUMNS] = None
    spacing: Annotated[
        float | None, _length("Distance between samples of a mesh", _FILE, callback=positive)
    ] = None
    cell: Annotated[
        float | None, _length("Edge of a cell of an occupancy grid", _FILE, callback=positive)
    ] = None
    corner: Annotated[Place | None, _place("Lower corner of an occupancy grid", _FILE)] = None
    height: Annotated[
        float | None, _length("Height of the rooms of a floor plan", _FILE, callback=positive)
    ] = None
    start: Annotated[Place | None, _place("Where to start", _FLIGHT)] = None
    goal: Annotated[Place | None, _place("Where to land", _FLIGHT)] = None
    radius: Annotated[
        float | None,
        _length(f"Distance to keep from points, {RADIUS} by default", _FLIGHT, min=0.0, callback=finite),
    ] = None
    lower: Annotated[Place | None, _place("Lower corner of the volume for the vehicle's centre", _FLIGHT)] = (
        None
    )
    upper: Annotated[Place | None, _place("Upper corner of the volume for the vehicle's centre", _FLIGHT)] = (
        None
    )

    @property
    def safety_radius(self) -> float:
        """Distance to keep from points, metres."""
        return RADIUS if self.radius is None else self.radius

    def read(self, file: Path) -> PointCloud:
        """The map of a file, read as the options say.

        Raises:
            ValueError: the file, or an option, is not as it must be.
            OSError: the file cannot be read.
            ImportError: the format's library is not installed.
        """
        layout = FileLayout(
            columns=_numbers(self.columns),
            cell=self.cell,
            corner=self.corner or (0.0, 0.0, 0.0),
            height=self.height,
        )
        options: dict[str, Any] = {} if self.spacing is None else {"spacing": self.spacing}
        options |= {"unit": self.unit, "offset": self.offset, "frame": self.frame, "layout": layout}
        return read_cloud(file, **options)

    def report(self, cloud: PointCloud) -> MapReport:
        """The report of a map for the flight that the options state."""
        limits = {"lower": self.lower, "upper": self.upper}
        return map_report(cloud, self.start, self.goal, self.safety_radius, **limits)


def closed_gap(cloud: PointCloud, radius: float) -> float:
    """Longest gap that a plan would close between neighbouring points of a map, metres."""
    voxel = CorridorOptions().voxel
    return with_closed_gaps(cloud if voxel is None else cloud.thinned(voxel), radius)[1]


def gap_text(gap: float) -> str:
    """The assumption that closing gaps is.

    Example:
        >>> gap_text(0.99)
        'gaps of up to 0.99 m between neighbouring points of a sparse surface are closed'
    """
    return f"gaps of up to {gap:.2g} m between neighbouring points of a sparse surface are closed"


def _numbers(columns: tuple[str, str, str] | None) -> tuple[str, str, str] | tuple[int, int, int] | None:
    """Columns by number where all three are numbers, else by name."""
    if columns is None or not all(column.isdecimal() for column in columns):
        return columns
    x, y, z = columns
    return int(x), int(y), int(z)
