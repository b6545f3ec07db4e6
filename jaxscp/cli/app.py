"""The command line: plan a scenario, or through a point cloud; print a report, write the trajectory and a picture.

An application, so that it may choose the precision for its process (``main`` switches float64 on) and its exit
codes: 0 the plan converged, 1 it did not, 2 the request was wrong.
"""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console

from jaxscp.aot.cache_folder import use_cache
from jaxscp.cli.options import with_options
from jaxscp.cli.report import converged, print_report, report, timed
from jaxscp.corridor import CorridorResult, PointCloud, box, build_corridor, read_cloud
from jaxscp.landing import scenarios
from jaxscp.landing.mission import at_rest
from jaxscp.landing.scenario import LandingScenario
from jaxscp.landing.validation import InvalidScenario
from jaxscp.planner.planner import Planner
from jaxscp.scp.nodal_subproblem import NormTrustRegion, ProximalTrustRegion
from jaxscp.scp.ptr import PTR
from jaxscp.solver.solution import Solution

CASES: dict[str, Callable[[], LandingScenario]] = {
    "platform": scenarios.platform_to_platform,
    "ascend": scenarios.ascent_to_platform,
}

MODES: dict[str, Callable[[int], Planner]] = {
    # second derivatives, safe between nodes
    "default": lambda nodes: Planner(nodes=nodes),
    # Table I of the paper
    "paper": lambda nodes: Planner(nodes=nodes, method=PTR(NormTrustRegion(10.0), virtual_weight=1000.0)),
    # a light weight takes long steps, many of them
    "proximal": lambda nodes: Planner(nodes=nodes, method=PTR(ProximalTrustRegion(0.02), max_iterations=200)),
}

Place = tuple[float, float, float]
PICTURED = 0.1  # m, between the points of a cloud in pictures
RADIUS = 0.25  # m, default distance to points of a cloud

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_show_locals=False)


@app.callback()
def jaxscp() -> None:
    """Plan six-degree-of-freedom flights by sequential convex programming."""


def _one_of(table: dict[str, Any]) -> str:
    return f"One of: {', '.join(table)}."


def _known(table: dict[str, Any], kind: str) -> Callable[[str | None], str | None]:
    def check(name: str | None) -> str | None:
        if name is not None and name not in table:
            raise typer.BadParameter(f"no {kind} is called {name!r}; choose from {', '.join(table)}")
        return name

    return check


def _writable(path: Path | None) -> Path | None:
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
    return _writable(path)


def _place(meaning: str) -> Any:
    return typer.Option(help=f"With --cloud: {meaning}, m.", metavar="X Y Z")


_MODE = typer.Option(callback=_known(MODES, "mode"), metavar="NAME", help=_one_of(MODES))
_CLOUD = typer.Option(help="Instead of a case: obstacles, .pcd .ply .xyz .npy .stl or .obj.", metavar="FILE")
_RADIUS = typer.Option(min=0.0, help=f"With --cloud: distance to keep from points, m. [default: {RADIUS}]")
_CROP = typer.Option(
    min=0.0, help="With --cloud: ignore points so near to start or goal, m; their decks, say."
)
_SAVE = typer.Option(callback=_writable, help="Write the trajectory (.npz).", metavar="FILE")
_PLOT = typer.Option(callback=_picture, help="Write a picture (.png, .pdf).", metavar="FILE")
_CACHE = typer.Option(
    callback=_cached, help="Store compiled programs here for the next run.", metavar="FOLDER"
)
_JSON = typer.Option("--json", help="Print one JSON object instead of tables.")


@dataclasses.dataclass
class PlanRequest:
    """Arguments and options of ``jaxscp plan``."""

    case: Annotated[
        str | None, typer.Argument(callback=_known(CASES, "case"), metavar="CASE", help=_one_of(CASES))
    ] = None
    mode: Annotated[str, _MODE] = "default"
    nodes: Annotated[int, typer.Option(min=2, help="Nodes N; the flight has N - 1 intervals.")] = 30
    cloud: Annotated[Path | None, _CLOUD] = None
    start: Annotated[Place | None, _place("where to start")] = None
    goal: Annotated[Place | None, _place("where to land")] = None
    radius: Annotated[float | None, _RADIUS] = None
    crop: Annotated[float | None, _CROP] = None
    lower: Annotated[Place | None, _place("lower corner of the flight volume")] = None
    upper: Annotated[Place | None, _place("upper corner of the flight volume")] = None
    save: Annotated[Path | None, _SAVE] = None
    plot: Annotated[Path | None, _PLOT] = None
    cache: Annotated[Path | None, _CACHE] = None
    as_json: Annotated[bool, _JSON] = False


@app.command()
@with_options(PlanRequest)
def plan(request: PlanRequest) -> None:
    """Plan a flight from a standing start to a landing: a stored case, or through a point cloud.

    Exit code: 0 if the plan converged, 1 if it did not, 2 if the request was wrong.
    """
    notes = Console(stderr=True, style="dim")
    name, scenario = _scenario(request, notes)
    planner = MODES[request.mode](request.nodes)
    try:
        scenario.check(request.nodes)
    except InvalidScenario as error:
        raise typer.BadParameter(str(error)) from error
    title = f"{name}, mode {request.mode}, {request.nodes} nodes"
    notes.print(f"planning {title}: compiling first ...")
    solution, timing = timed(planner, scenario)
    if request.as_json:
        facts = {"case": name, "mode": request.mode, "nodes": request.nodes, **report(solution, timing)}
        typer.echo(json.dumps(facts, allow_nan=False))
    else:
        print_report(Console(), title, solution, timing)
    _write_files(request, scenario, solution)
    raise typer.Exit(0 if converged(solution) else 1)


def _write_files(request: PlanRequest, scenario: LandingScenario, solution: Solution) -> None:
    if request.save is not None:
        solution.trajectory.save(request.save)
    if request.plot is not None:
        from jaxscp.plot.page import summary

        summary(scenario, solution).savefig(request.plot, dpi=80)


def _scenario(request: PlanRequest, notes: Console) -> tuple[str, LandingScenario]:
    """Name and scenario of a request; ends the program if there is no corridor."""
    of_cloud = (request.start, request.goal, request.radius, request.crop, request.lower, request.upper)
    if request.cloud is None:
        if request.case is None:
            raise typer.BadParameter(f"name a case ({', '.join(CASES)}), or give --cloud, --start and --goal")
        if any(v is not None for v in of_cloud):
            raise typer.BadParameter("--start, --goal, --radius, --crop, --lower and --upper go with --cloud")
        return request.case, CASES[request.case]()
    if request.case is not None or request.start is None or request.goal is None:
        raise typer.BadParameter("--cloud needs --start and --goal, and no case")
    points, result = _corridor(request, request.cloud)
    notes.print(result.message)
    if result.corridor is None or not result.found:
        if request.as_json:
            facts = {"case": request.cloud.name, "status": "no_corridor", "message": result.message}
            typer.echo(json.dumps(facts))
        raise typer.Exit(1)
    pictured = jnp.asarray(points.thinned(PICTURED).points)
    ends = at_rest(request.start), at_rest(request.goal)
    return request.cloud.name, scenarios.through(result.corridor, *ends, pictured)


def _corridor(request: PlanRequest, file: Path) -> tuple[PointCloud, CorridorResult]:
    """Read a cloud and build the corridor; errors of the request name its option."""
    first, last = np.array(request.start), np.array(request.goal)
    low, high = (None if corner is None else np.array(corner) for corner in (request.lower, request.upper))
    crop = request.crop or 0.0
    radius = RADIUS if request.radius is None else request.radius
    decks = [box(place - crop, place + crop) for place in (first, last)] if crop else []
    try:
        points = read_cloud(file)
        return points, build_corridor(points, first, last, radius, lower=low, upper=high, remove=decks)
    except (ValueError, OSError, ImportError) as error:
        raise typer.BadParameter(str(error)) from error


def main() -> None:
    """Entry point of the program."""
    jax.config.update("jax_enable_x64", True)
    app()
