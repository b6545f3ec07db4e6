"""Reports of a solution: tables for people, JSON for scripts."""

import functools
import math
import time
from typing import Any, NamedTuple

import jax
import numpy as np
from rich.console import Console

from jaxscp.core.status import Status, status_names
from jaxscp.corridor.map_report import MapReport
from jaxscp.landing.scenario import LandingScenario
from jaxscp.solver.planner import Planner
from jaxscp.solver.solution import Solution


class Timing(NamedTuple):
    """Seconds of a plan."""

    solve: float
    """Of a second call, with all compiled: guess, subproblems and certificate."""
    compile: float
    """Of the first call, beyond that."""


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
    """The JSON object: plain numbers in SI units; null in place of NaN and infinity."""
    certificate = solution.certificate
    checks = zip(certificate.names, certificate.at_nodes, certificate.between_nodes, strict=True)
    return {
        "status": status_names(solution.status),
        "cause": solution.cause(),
        "iterations": int(solution.iterations),
        "interior_point_iterations": int(solution.interior_point_iterations),
        "cost": plain(solution.cost),
        "final_time": plain(solution.final_time),
        "solve_seconds": timing.solve,
        "compile_seconds": timing.compile,
        "defect": plain(certificate.defect),
        "violation": plain(certificate.violation),
        "clearance": None if certificate.clearance is None else plain(certificate.clearance),
        "backends": solution.backends.names(),
        "optimality": None if certificate.optimality is None else plain(certificate.optimality),
        "end_error": {
            "position": plain(certificate.error("final position")),
            "velocity": plain(certificate.error("final velocity")),
            "attitude": plain(certificate.error("final attitude")),
            "body_rate": plain(certificate.error("final body rate")),
        },
        "constraints": {
            name: {"at_nodes": plain(at), "between_nodes": plain(between)} for name, at, between in checks
        },
        "history": history(solution),
    }


def history(solution: Solution) -> list[dict[str, Any]]:
    """One dict an iteration, with the quantities that the method records."""
    columns = {name: np.asarray(values) for name, values in vars(solution.history).items()}
    return [
        {"iteration": row + 1, **{name: plain(values[row]) for name, values in columns.items()}}
        for row in range(int(solution.iterations))
    ]


def map_facts(facts: MapReport, closed_gap: float = 0.0) -> dict[str, Any]:
    """The JSON object of a map: lengths in metres; null for a distance that no two points have."""
    return {
        "file": facts.source,
        "status": "accepted" if facts.accepted else "refused",
        "message": "; ".join(facts.refused),
        "points": facts.points,
        "dropped": facts.dropped,
        "strays": facts.strays,
        "lower": [plain(value) for value in facts.lower],
        "upper": [plain(value) for value in facts.upper],
        "spacing": plain(facts.spacing),
        "radius": facts.radius,
        "closed_gap": plain(closed_gap),
        "inside": None if facts.inside is None else dict(zip(("start", "goal"), facts.inside, strict=True)),
        "assumed": list(facts.assumed),
        "warnings": list(facts.warnings),
        "refused": list(facts.refused),
    }


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
    """Print the iterations, the status, the certificate and the times."""
    count = max(int(solution.iterations), 1)
    show = functools.partial(console.print, highlight=False, soft_wrap=True)
    show(title, style="bold")
    show(solution.iteration_table())
    show(
        f"status: {status_names(solution.status)}", style="bold green" if converged(solution) else "bold red"
    )
    show(Status[solution.status])
    if cause := solution.cause():
        show(cause)
    show(solution.backends.report())
    show(f"cost {float(solution.cost):.6g}, flight time {float(solution.final_time):.4g} s")
    show("\ncertificate: the controls integrated again from the start, without correction", style="bold")
    show(solution.certificate.report())
    show("\ntime", style="bold")
    show(f"{1e3 * timing.solve:.1f} ms a plan once compiled: guess, {count} iterations, end, certificate")
    show(f"{timing.compile:.1f} s to compile")
