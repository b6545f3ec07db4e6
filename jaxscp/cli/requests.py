"""What ``jaxscp plan`` and ``jaxscp map`` may be asked: arguments and options, checked before anything compiles."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import equinox as eqx
import typer

from jaxscp.aot.cache_folder import use_cache
from jaxscp.cli.map_options import MapOptions, finite, known, one_of, positive
from jaxscp.core.arrays import floats
from jaxscp.corridor import CorridorOptions
from jaxscp.landing import scenarios
from jaxscp.landing.scenario import LandingScenario
from jaxscp.solver.planner import Planner

CASES: dict[str, Callable[[], LandingScenario]] = {
    "platform": scenarios.platform_to_platform,
    "ascend": scenarios.ascent_to_platform,
}

MODES: dict[str, Callable[[int | None], Planner]] = {
    # second derivatives, safe between nodes
    "default": lambda nodes: Planner(nodes=nodes),
    # Table I of the paper
    "paper": Planner.paper,
    # a light weight takes long steps, many of them
    "proximal": Planner.proximal,
}

CLEARANCE = CorridorOptions().clearance
RATE = 100  # rows a second of a table


def writable(path: Path | None) -> Path | None:
    """Try to write before compiling for minutes; leaves no file behind."""
    if path is None:
        return None
    new = not path.exists()
    try:
        path.open("ab").close()
    except OSError as error:
        raise typer.BadParameter(f"cannot write {path}: {error.strerror}") from error
    if new:
        path.unlink()
    return path


def _cached(folder: Path | None) -> Path | None:
    if folder is not None:
        try:
            use_cache(folder)
        except OSError as error:
            raise typer.BadParameter(f"cannot make {folder}: {error.strerror}") from error
    return folder


def _picture(path: Path | None) -> Path | None:
    if path is not None:
        from matplotlib.backend_bases import FigureCanvasBase

        kinds = FigureCanvasBase.get_supported_filetypes()
        if path.suffix.lstrip(".").lower() not in kinds:
            raise typer.BadParameter(f"{path} is no picture; end its name in .{', .'.join(sorted(kinds))}")
    return writable(path)


_MODE = typer.Option(callback=known(MODES, "mode"), metavar="NAME", help=one_of(MODES))
_CLOUD = typer.Option(
    help="Instead of a case: a map, .pcd .ply .xyz .npy .stl .obj and others.", metavar="FILE"
)
_CROP = typer.Option(
    min=0.0,
    callback=finite,
    metavar="LENGTH",
    help="Points so near to start or goal are their decks, which the vehicle may stand on, m.",
)
_CLEARANCE = typer.Option(
    min=0.0,
    callback=finite,
    metavar="LENGTH",
    help=f"Distance to keep besides the radius, and radius of overlaps, {CLEARANCE:g} by default, m.",
)
_SAVE = typer.Option(callback=writable, help="Write the trajectory (.npz).", metavar="FILE")
_CSV = typer.Option(
    callback=writable, help=f"Write {RATE} states and thrusts a second, and the end (.csv).", metavar="FILE"
)
_PLOT = typer.Option(callback=_picture, help="Write a picture (.png, .pdf).", metavar="FILE")
# Named here: some versions of typer make a metavar the option's name where the two differ in case alone.
_MASS = typer.Option(
    "--mass", callback=positive, metavar="MASS", help="Of the vehicle instead of its own, kg."
)
_SPEED = typer.Option(
    "--speed", callback=positive, metavar="SPEED", help="Greatest speed, m/s; none by default."
)
_TIME_WEIGHT = typer.Option(
    min=0.0,
    callback=finite,
    metavar="WEIGHT",
    help="Weight of the flight time in the cost; that of the control is 1.",
)
CACHE = typer.Option(
    callback=_cached, help="Store compiled programs here for the next run.", metavar="FOLDER"
)
JSON = typer.Option("--json", help="Print one JSON object instead of tables.")
_NODES = typer.Option(
    min=2, help="Nodes N; the flight has N - 1 intervals. By default 30 or as many as it needs."
)
_PICTURE = typer.Option(callback=_picture, help="Draw the map from above and from the side.", metavar="FILE")


@dataclasses.dataclass
class PlanRequest(MapOptions):
    """Arguments and options of ``jaxscp plan``."""

    crop: Annotated[float | None, _CROP] = None
    clearance: Annotated[float | None, _CLEARANCE] = None
    case: Annotated[
        str | None, typer.Argument(callback=known(CASES, "case"), metavar="CASE", help=one_of(CASES))
    ] = None
    mode: Annotated[str, _MODE] = "default"
    nodes: Annotated[int | None, _NODES] = None
    cloud: Annotated[Path | None, _CLOUD] = None
    mass: Annotated[float | None, _MASS] = None
    speed: Annotated[float | None, _SPEED] = None
    time_weight: Annotated[float | None, _TIME_WEIGHT] = None
    save: Annotated[Path | None, _SAVE] = None
    csv: Annotated[Path | None, _CSV] = None
    plot: Annotated[Path | None, _PLOT] = None
    cache: Annotated[Path | None, CACHE] = None
    as_json: Annotated[bool, JSON] = False

    def changed(self, scenario: LandingScenario) -> LandingScenario:
        """A scenario with the mass, the limit and the weight that were asked for."""
        if self.mass is not None:
            scenario = eqx.tree_at(lambda s: s.airframe.body.mass, scenario, floats(self.mass))
        if self.speed is not None:
            scenario = dataclasses.replace(
                scenario, limits=dataclasses.replace(scenario.limits, speed=self.speed)
            )
        if self.time_weight is not None:
            scenario = dataclasses.replace(
                scenario, weights=dataclasses.replace(scenario.weights, time=self.time_weight)
            )
        return scenario


@dataclasses.dataclass(kw_only=True)
class MapRequest(MapOptions):
    """Arguments and options of ``jaxscp map``."""

    file: Annotated[Path, typer.Argument(metavar="FILE", help="The map.")]
    picture: Annotated[Path | None, _PICTURE] = None
    as_json: Annotated[bool, JSON] = False
