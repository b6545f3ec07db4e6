"""Ours beside the published stack and IPOPT: whole plans, in one process, from the same guess.

``paper_ratio``: the published stack (CVXPY, CLARABEL, Numba) over ours, the same problem by the same method to the same
stop. ``optimum_ratio``: its time to that stop over ours to the certified optimum, which is a better flight.
``ipopt_ratio``: IPOPT's time to that optimum's cost over ours, on the identical transcription.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.speed.timing import elapsed
from jaxscp import LandingScenario, Planner, scenarios, status_names

MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
FIRST = "platform"  # whose ratios are the benchmark's
SAME_COST = 1e-3  # relative difference of costs that count as the same


def run(echo: Callable[[str], None], nodes: int, repeats: int) -> dict[str, Any]:
    """Both missions in the paper's mode, and the first in the default mode."""
    echo(f"{'to the same stop':18}{'cost':>20}{'subproblems':>14}{'warm solve ms':>20}{'ratio':>8}")
    echo(f"{'':18}{'ours':>10}{'published':>10}{'ours':>7}{'publ.':>7}{'ours':>10}{'published':>10}")
    published = {name: against_published(name, nodes, repeats, echo) for name in MISSIONS}
    optimum = to_optimum(MISSIONS[FIRST](), nodes, repeats, echo)
    optimum_ratio = optimum["seconds_published"] / optimum["seconds"]
    ipopt_ratio = optimum["seconds_ipopt"] / optimum["seconds"]
    echo(f"the published stack's stop over that: {optimum_ratio:.2f} times; IPOPT: {ipopt_ratio:.1f} times")
    return {
        "paper_ratio": published[FIRST]["ratio"],
        "optimum_ratio": optimum_ratio,
        "ipopt_ratio": ipopt_ratio if optimum["same_cost"] else None,
        "published": published,
        "optimum": optimum,
    }


def against_published(name: str, nodes: int, repeats: int, echo: Callable[[str], None]) -> dict[str, Any]:
    """The paper's mode and the published stack, in turns."""
    from benchmarks.rivals import paper
    from benchmarks.rivals.convert import as_arrays, as_method, as_problem

    arrays = as_arrays(MISSIONS[name](), nodes)
    solve, (problem, z) = jax.jit(as_method(arrays).run), as_problem(arrays)
    ours, theirs = jax.block_until_ready(solve(problem, z)), paper.solve(arrays)
    times, times_published = [], []
    for _ in range(repeats):
        times.append(elapsed(lambda: solve(problem, z)))
        times_published.append(_seconds(paper.solve(arrays)))
    row = {
        "cost": float(ours.cost),
        "cost_published": float(theirs.iterations[-1].cost),
        "iterations": int(ours.iterations),
        "iterations_published": len(theirs.iterations),
        "seconds": float(np.median(times)),
        "seconds_published": float(np.median(times_published)),
    }
    row["ratio"] = row["seconds_published"] / row["seconds"]
    echo(
        f"{name:18}{row['cost']:10.4f}{row['cost_published']:10.4f}{row['iterations']:7d}"
        f"{row['iterations_published']:7d}{1e3 * row['seconds']:10.1f}{1e3 * row['seconds_published']:10.1f}"
        f"{row['ratio']:8.2f}"
    )
    return row


def _seconds(published: Any) -> float:
    return sum(i.discretise_seconds + i.setup_seconds + i.solver_seconds for i in published.iterations)


def to_optimum(
    scenario: LandingScenario, nodes: int, repeats: int, echo: Callable[[str], None]
) -> dict[str, Any]:
    """The default mode's whole plan, guess and certificate included, in turns with the published stack to its stop; and
    IPOPT's solution alone."""
    from benchmarks.rivals import paper
    from benchmarks.rivals.convert import as_arrays
    from benchmarks.rivals.optimum import Optimum

    planner = Planner(nodes=nodes)
    ours = jax.block_until_ready(planner(scenario))
    arrays = as_arrays(scenario, nodes)
    starts = Optimum(arrays).solve(1)  # from the guess itself
    times, times_published = [], []
    for _ in range(repeats):
        times.append(elapsed(lambda: planner(scenario)))
        times_published.append(_seconds(paper.solve(arrays)))
    starts += Optimum(arrays).solve(1)
    cost, cost_ipopt, seconds = float(ours.cost), starts[0].cost, float(np.median(times))
    seconds_ipopt = min(start.seconds for start in starts)
    echo(
        f"to the optimum, {nodes} nodes: ours {cost:.4f} ({status_names(ours.status)}) in {1e3 * seconds:.1f} ms,"
    )
    echo(
        f"IPOPT {cost_ipopt:.4f} ({starts[0].status}, {starts[0].iterations} iterations) in {seconds_ipopt:.2f} s"
    )
    return {
        "status": str(status_names(ours.status)),
        "cost": cost,
        "cost_ipopt": cost_ipopt,
        "same_cost": starts[0].status == "Solve_Succeeded" and abs(cost_ipopt / cost - 1.0) < SAME_COST,
        "seconds": seconds,
        "seconds_published": float(np.median(times_published)),
        "seconds_ipopt": seconds_ipopt,
        "ipopt": dataclasses.asdict(starts[0]),
    }
