"""The command line: plan a scenario, or through a point cloud; print a report, write the trajectory and a picture.

An application, so that it may choose the precision for its process (``main`` switches float64 on) and its exit
codes: 0 the plan converged, 1 it did not, 2 the request was wrong.
"""

import dataclasses
import json
import warnings
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console

from jaxscp.aot.installation import installation
from jaxscp.cli.endings import Commands, check_platform, refusals, told_of_files, told_warnings
from jaxscp.cli.info import info_text
from jaxscp.cli.map_options import MapOptions, closed_gap, gap_text
from jaxscp.cli.mission_command import MissionRequest
from jaxscp.cli.options import with_options
from jaxscp.cli.report import converged, map_facts, print_report, report, timed
from jaxscp.cli.requests import CASES, CLEARANCE, JSON, MODES, RATE, MapRequest, PlanRequest
from jaxscp.cli.sweep_command import SweepRequest
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.version import __version__
from jaxscp.corridor import CorridorResult, MapReport, PointCloud, box, build_corridor, draw_map
from jaxscp.landing import scenarios
from jaxscp.landing.mission import at_rest
from jaxscp.landing.scenario import LandingScenario
from jaxscp.solver.solution import Solution

PICTURED = 0.1  # m, between the points of a cloud in pictures

app = typer.Typer(
    cls=Commands, add_completion=False, no_args_is_help=True, pretty_exceptions_show_locals=False
)


def _version(asked: bool) -> bool:
    if asked:
        typer.echo(f"jaxscp {__version__}")
        raise typer.Exit
    return asked


_VERSION = typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")


@app.callback()
def jaxscp(version: Annotated[bool, _VERSION] = False) -> None:
    """Plan six-degree-of-freedom flights by sequential convex programming."""


@app.command(name="info")
def info_command(as_json: Annotated[bool, JSON] = False) -> None:
    """Print versions, devices, the compiled libraries that serve, why others do not, and the cache."""
    check_platform()
    facts = installation()
    if as_json:
        typer.echo(json.dumps(facts))
    else:
        Console().print(info_text(facts), markup=False, highlight=False, soft_wrap=True)


@app.command()
@with_options(PlanRequest)
def plan(request: PlanRequest) -> None:
    """Plan a flight from a standing start to a landing: a stored case, or through a point cloud.

    Exit code: 0 if the plan converged, 1 if it did not, 2 if the request was wrong.
    """
    notes = Console(stderr=True, style="dim")
    check_platform()
    name, scenario, facts = _scenario(request, notes)
    planner = MODES[request.mode](request.nodes)
    try:
        nodes = planner.nodes_for(scenario)
        scenario.check(nodes)
    except InvalidScenario as error:
        raise typer.BadParameter(str(error)) from error
    title = f"{name}, mode {request.mode}, {nodes} nodes"
    hint = "" if request.cache else "; with --cache FOLDER, the next command need not"
    notes.print(f"planning {title}: compiling first{hint} ...")
    solution, timing = timed(planner, scenario)
    if request.as_json:
        facts = {
            "case": name,
            "mode": request.mode,
            "nodes": nodes,
            **report(solution, timing),
            **facts,
            "info": installation(),
        }
        typer.echo(json.dumps(facts, allow_nan=False))
    else:
        print_report(Console(), title, solution, timing)
    _write_files(request, scenario, solution)
    told_of_files(notes, request.save, request.csv, request.plot)
    raise typer.Exit(0 if converged(solution) else 1)


@app.command(name="map")
@with_options(MapRequest)
def map_command(request: MapRequest) -> None:
    """Print facts about a map: points, extent, spacing, assumptions, and reasons to refuse it.

    Exit code: 0 if a flight may be planned in the map, 2 if the map is refused.
    """
    if (request.start is None) != (request.goal is None):
        raise typer.BadParameter("--start and --goal go together")
    with refusals(), told_warnings(Console(stderr=True)):
        cloud = request.read(request.file)
        facts = request.report(cloud)
        gap = closed_gap(cloud, request.safety_radius) if facts.accepted else 0.0
    if gap:
        facts = dataclasses.replace(facts, assumed=(*facts.assumed, gap_text(gap)))
    if request.as_json:
        typer.echo(json.dumps(map_facts(facts, gap), allow_nan=False))
    else:
        Console().print(str(facts), markup=False, highlight=False, soft_wrap=True)
    if request.picture is not None:
        draw_map(cloud, facts, start=request.start, goal=request.goal).savefig(request.picture, dpi=80)
    raise typer.Exit(0 if facts.accepted else 2)


@app.command(name="sweep")
@with_options(SweepRequest)
def sweep_command(request: SweepRequest) -> None:
    """Run many cases of a study that scatters, and print statistics; the same command goes on where it was ended.

    Exit code: 0 if the sweep is finished, 2 if the request was wrong, 130 after Ctrl-C.
    """
    request.run()


@app.command(name="mission")
@with_options(MissionRequest)
def mission_command(request: MissionRequest) -> None:
    """Fly a whole mission in simulation: start from the carrier, plan, fly, return, land on its deck.

    Exit code: 0 if the vehicle was at its goal and landed, 1 if not, 2 if the request was wrong.
    """
    raise typer.Exit(0 if request.run() else 1)


def _write_files(request: PlanRequest, scenario: LandingScenario, solution: Solution) -> None:
    if request.save is not None:
        solution.trajectory.save(request.save)
    if request.csv is not None:
        solution.trajectory.sample(rate=RATE, end=True).to_csv(request.csv)
    if request.plot is not None:
        from jaxscp.plot.page import summary

        summary(scenario, solution).savefig(request.plot)


def _scenario(request: PlanRequest, notes: Console) -> tuple[str, LandingScenario, dict[str, Any]]:
    """Name and scenario of a request, and facts about its map; ends the program if there is no corridor."""
    if request.cloud is None:
        if request.case is None:
            raise typer.BadParameter(f"name a case ({', '.join(CASES)}), or give --cloud, --start and --goal")
        for_maps = [field.name for field in dataclasses.fields(MapOptions)] + ["crop", "clearance"]
        given = [f"--{name}" for name in for_maps if getattr(request, name) is not None]
        if given:
            raise typer.BadParameter(f"these options go with --cloud: {', '.join(given)}")
        return request.case, request.changed(CASES[request.case]()), {}
    if request.case is not None or request.start is None or request.goal is None:
        raise typer.BadParameter("--cloud needs --start and --goal, and no case")
    points, result = _corridor(request, request.cloud, notes)
    facts = {"map": map_facts(result.report, result.closed_gap)}
    notes.print(result.message, markup=False)
    if result.corridor is None or not result.found:
        if request.as_json:
            ending = {"case": request.cloud.name, "status": "no_corridor", "message": result.message}
            typer.echo(json.dumps({**ending, **facts}, allow_nan=False))
        raise typer.Exit(1)
    pictured = jnp.asarray(points.thinned(PICTURED).points)
    ends = at_rest(request.start), at_rest(request.goal)
    known = {"obstacles": pictured, "near_obstacles": result.near_obstacles}
    scenario = scenarios.through(result.corridor, *ends, **known)
    return request.cloud.name, request.changed(scenario), facts


def _corridor(request: PlanRequest, file: Path, notes: Console) -> tuple[PointCloud, CorridorResult]:
    """Read a map and build the corridor; errors of the request name its option."""
    first, last = np.array(request.start), np.array(request.goal)
    crop = request.crop or 0.0
    clearance = CLEARANCE if request.clearance is None else request.clearance
    decks = [box(place - crop, place + crop) for place in (first, last)] if crop else []
    options = {"lower": request.lower, "upper": request.upper, "clearance": clearance, "remove": decks}
    with refusals(), told_warnings(Console(stderr=True)):
        points = request.read(file)
        if request.safety_radius < (hull := float(scenarios.usual_airframe().radius)):
            warnings.warn(
                f"--radius {request.safety_radius:g} m is below the vehicle's radius, {hull:g} m: a plan so near to "
                f"a point is not converged; give --radius {hull:g} or more",
                stacklevel=1,
            )
        try:
            result = build_corridor(points, first, last, request.safety_radius, **options)
        except ValueError:  # an assumption may be its cause
            _print_assumptions(notes, request.report(points))
            raise
        _print_assumptions(notes, result.report)
    return points, result


def _print_assumptions(notes: Console, facts: MapReport) -> None:
    for assumption in facts.assumed:
        notes.print(f"assumed: {assumption}", markup=False, soft_wrap=True)


def main() -> None:
    """Switch float64 on and run the command; ``jaxscp.cli.start`` is the entry point of the program."""
    jax.config.update("jax_enable_x64", True)
    app()
