"""The command line: plan a scenario, or through a point cloud; print what happened, write the trajectory and a picture.

An application, so it may choose the precision for its process (``main`` switches float64 on) and its exit
codes: 0 the plan converged, 1 it did not, 2 the request was wrong.
"""

import functools
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from jaxscp.aot.cache_folder import use_cache
from jaxscp.core.status import Status, status_names
from jaxscp.corridor import CorridorResult, PointCloud, box, build_corridor, read_cloud
from jaxscp.landing import scenarios
from jaxscp.landing.scenario import LandingScenario, at_rest
from jaxscp.landing.validation import InvalidScenario, validate
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

# quantity of the history -> heading, format
COLUMNS = {
    "cost": ("cost", ".4f"),
    "final_time": (r"t_f \[s]", ".3f"),
    "virtual": ("|nu|", ".1e"),
    "step": ("|dz|", ".1e"),
    "defect": ("defect", ".1e"),
    "conic_iterations": ("conic steps", "d"),
}

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_show_locals=False)


class Timing(NamedTuple):
    """Seconds that a plan took."""

    solve: float
    """A second call, everything compiled: guess, all subproblems and the certificate."""
    compile: float
    """What the first call took beyond that."""


@app.callback()
def jaxscp() -> None:
    """Plan six-degree-of-freedom flights by sequential convex programming."""


def _one_of(table: dict[str, Any]) -> str:
    return f"One of: {', '.join(table)}."


def _known(table: dict[str, Any], what: str) -> Callable[[str | None], str | None]:
    def check(name: str | None) -> str | None:
        if name is not None and name not in table:
            raise typer.BadParameter(f"no {what} is called {name!r}; choose from {', '.join(table)}")
        return name

    return check


def _writable(path: Path | None) -> Path | None:
    """Try to write before minutes go into compiling; leaves no file behind."""
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


Place = tuple[float, float, float]
PICTURED = 0.1  # m, between the points of a cloud that pictures show
RADIUS = 0.25  # m, to keep from points of a cloud unless said otherwise


def _place(what: str) -> Any:
    return typer.Option(help=f"With --cloud: {what}, m.", metavar="X Y Z")


@app.command()
def plan(
    case: Annotated[
        str | None,
        typer.Argument(callback=_known(CASES, "case"), metavar="CASE", help=_one_of(CASES)),
    ] = None,
    mode: Annotated[
        str, typer.Option(callback=_known(MODES, "mode"), metavar="NAME", help=_one_of(MODES))
    ] = "default",
    nodes: Annotated[int, typer.Option(min=2, help="Nodes N; the flight has N - 1 intervals.")] = 30,
    cloud: Annotated[
        Path | None,
        typer.Option(help="Instead of a case: obstacles, .pcd .ply .xyz .npy .stl or .obj.", metavar="FILE"),
    ] = None,
    start: Annotated[Place | None, _place("where to start")] = None,
    goal: Annotated[Place | None, _place("where to land")] = None,
    radius: Annotated[
        float | None,
        typer.Option(min=0.0, help=f"With --cloud: distance to keep from points, m. [default: {RADIUS}]"),
    ] = None,
    crop: Annotated[
        float | None,
        typer.Option(
            min=0.0, help="With --cloud: ignore points so near to start or goal, m; their decks, say."
        ),
    ] = None,
    lower: Annotated[Place | None, _place("lower corner of where to fly")] = None,
    upper: Annotated[Place | None, _place("upper corner of where to fly")] = None,
    save: Annotated[
        Path | None, typer.Option(callback=_writable, help="Write the trajectory (.npz).", metavar="FILE")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(callback=_picture, help="Write a picture (.png, .pdf).", metavar="FILE"),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            callback=_cached, help="Keep compiled programs here for the next run.", metavar="FOLDER"
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> None:
    """Plan a flight from a standing start to a landing: a stored case, or through a point cloud.

    Exit code: 0 if the plan converged, 1 if it did not, 2 if the request was wrong.
    """
    notes = Console(stderr=True, style="dim")
    if cloud is None:
        if case is None:
            raise typer.BadParameter(f"name a case ({', '.join(CASES)}), or give --cloud, --start and --goal")
        if any(v is not None for v in (start, goal, radius, crop, lower, upper)):
            raise typer.BadParameter("--start, --goal, --radius, --crop, --lower and --upper go with --cloud")
        scenario, name = CASES[case](), case
    else:
        if case is not None or start is None or goal is None:
            raise typer.BadParameter("--cloud needs --start and --goal, and no case")
        keep = RADIUS if radius is None else radius
        points, result = _corridor(cloud, start, goal, keep, crop or 0.0, lower, upper)
        notes.print(result.message)
        name = cloud.name
        if result.corridor is None or not result.found:
            if as_json:
                typer.echo(json.dumps({"case": name, "status": "no_corridor", "message": result.message}))
            raise typer.Exit(1)
        pictured = jnp.asarray(points.thinned(PICTURED).points)
        scenario = scenarios.through(result.corridor, at_rest(start), at_rest(goal), pictured)
    planner = MODES[mode](nodes)
    try:
        validate(scenario, nodes)
    except InvalidScenario as error:
        raise typer.BadParameter(str(error)) from error
    notes.print(f"planning {name}, mode {mode}, {nodes} nodes: compiling first ...")
    solution, timing = timed(planner, scenario)
    if as_json:
        facts = {"case": name, "mode": mode, "nodes": nodes, **report(solution, timing)}
        typer.echo(json.dumps(facts, allow_nan=False))
    else:
        print_report(Console(), f"{name}, mode {mode}, {nodes} nodes", solution, timing)
    if save is not None:
        solution.trajectory.save(save)
    if plot is not None:
        from jaxscp.plot import summary

        summary(scenario, solution).savefig(plot, dpi=80)
    raise typer.Exit(0 if converged(solution) else 1)


def _corridor(
    file: Path,
    start: Place,
    goal: Place,
    radius: float,
    crop: float,
    lower: Place | None,
    upper: Place | None,
) -> tuple[PointCloud, CorridorResult]:
    """Read a cloud and build the corridor; what is wrong with the request is said as such."""
    first, last = np.array(start), np.array(goal)
    low, high = (None if corner is None else np.array(corner) for corner in (lower, upper))
    decks = [box(place - crop, place + crop) for place in (first, last)] if crop else []
    try:
        points = read_cloud(file)
        return points, build_corridor(points, first, last, radius, lower=low, upper=high, remove=decks)
    except (ValueError, OSError, ImportError) as error:
        raise typer.BadParameter(str(error)) from error


def timed(planner: Planner, scenario: LandingScenario) -> tuple[Solution, Timing]:
    """Plan twice: the first call compiles, the second one is timed."""
    first = time.perf_counter()
    jax.block_until_ready(planner(scenario))
    second = time.perf_counter()
    solution = jax.block_until_ready(planner(scenario))
    solve = time.perf_counter() - second
    return solution, Timing(solve, max(second - first - solve, 0.0))


def converged(solution: Solution) -> bool:
    """Whether the plan may be flown."""
    return bool(solution.status == Status.converged)


def report(solution: Solution, timing: Timing) -> dict[str, Any]:
    """What ``--json`` prints: plain numbers in SI units, none of them NaN or infinite (null instead)."""
    certificate = solution.certificate
    checks = zip(certificate.names, certificate.at_nodes, certificate.between_nodes, strict=True)
    return {
        "status": status_names(solution.status),
        "iterations": int(solution.iterations),
        "newton_steps": int(solution.newton_steps),
        "cost": plain(solution.cost),
        "final_time": plain(solution.final_time),
        "solve_seconds": timing.solve,
        "compile_seconds": timing.compile,
        "defect": plain(certificate.defect),
        "violation": plain(certificate.violation),
        "optimality": None if certificate.optimality is None else plain(certificate.optimality),
        "end_error": {
            "position": plain(certificate.position_error),
            "velocity": plain(certificate.velocity_error),
            "attitude": plain(certificate.attitude_error),
            "body_rate": plain(certificate.rate_error),
        },
        "constraints": {
            name: {"at_nodes": plain(at), "between_nodes": plain(between)} for name, at, between in checks
        },
        "history": history(solution),
    }


def history(solution: Solution) -> list[dict[str, Any]]:
    """One dict an iteration, with whatever quantities the method records."""
    columns = {name: np.asarray(values) for name, values in vars(solution.history).items()}
    return [
        {"iteration": row + 1, **{name: plain(values[row]) for name, values in columns.items()}}
        for row in range(int(solution.iterations))
    ]


def plain(value: Any) -> int | float | None:
    """A number that JSON can hold.

    Example:
        >>> import jax.numpy as jnp
        >>> plain(jnp.array(2)), plain(jnp.array(0.5)), plain(jnp.array(jnp.nan))
        (2, 0.5, None)
    """
    number = np.asarray(value).item()
    return number if math.isfinite(number) else None


def print_report(console: Console, title: str, solution: Solution, timing: Timing) -> None:
    """The iterations, how they ended, what the certificate found, and how long it took."""
    count = max(int(solution.iterations), 1)
    show = functools.partial(console.print, highlight=False, soft_wrap=True)
    show(iteration_table(title, solution))
    show(
        f"status: {status_names(solution.status)}", style="bold green" if converged(solution) else "bold red"
    )
    show(Status[solution.status])
    if bool(solution.differentiable):
        steps = int(solution.newton_steps)
        show(f"from the last iterate, {steps} Newton steps led to the optimum itself")
    show(f"cost {float(solution.cost):.6g}, flight time {float(solution.final_time):.4g} s")
    show("\ncertificate: the controls flown again from the start, without correction", style="bold")
    show(solution.certificate.report())
    show("\ntime", style="bold")
    show(f"{1e3 * timing.solve:.1f} ms a plan once compiled: guess, {count} iterations, end, certificate")
    show(f"{timing.compile:.1f} s to compile")


def iteration_table(title: str, solution: Solution) -> Table:
    """One row an iteration."""
    rows = history(solution)
    shown = {name: column for name, column in COLUMNS.items() if rows and name in rows[0]}
    table = Table(title=title, title_justify="left", title_style="bold")
    for heading in ("iteration", *(heading for heading, _ in shown.values())):
        table.add_column(heading, justify="right")
    for row in rows:
        cells = ("-" if row[name] is None else format(row[name], style) for name, (_, style) in shown.items())
        table.add_row(str(row["iteration"]), *cells)
    return table


def main() -> None:
    """Entry point of the program."""
    jax.config.update("jax_enable_x64", True)
    app()
