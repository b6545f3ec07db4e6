"""Times of jaxscp, the published stack and IPOPT: whole plans from the same guess, in turns, in separate processes.

``paper_ratio``: time of the published stack (CVXPY, CLARABEL, Numba) over time of jaxscp. Problem, method and stop are
the same. ``optimum_ratio``: time of the published stack to its stop over time of jaxscp to the certified optimum, which
has a lower cost. ``ipopt_ratio``: time of IPOPT to the optimum's cost over time of jaxscp, on the identical
transcription.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.speed.apart import Apart, in_turns
from benchmarks.speed.timing import elapsed
from jaxscp import Planner, scenarios, status_names

MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
FIRST = "platform"  # the mission of the reported ratios
CALLS = 5  # calls in a turn
SAME_COST = 1e-3  # largest relative difference of equal costs


def run(echo: Callable[[str], None], nodes: int, repeats: int) -> dict[str, Any]:
    """Figures of both missions in the paper's mode, and of the first in the default mode."""
    echo(f"{'to the same stop':18}{'cost':>20}{'subproblems':>14}{'warm solve ms':>20}{'ratio':>8}")
    echo(f"{'':18}{'ours':>10}{'published':>10}{'ours':>7}{'publ.':>7}{'ours':>10}{'published':>10}")
    published = {name: against_published(name, nodes, repeats, echo) for name in MISSIONS}
    optimum = to_optimum(FIRST, nodes, repeats, echo)
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
    """Figures of the paper's mode and of the published stack."""
    with _warm(ours_to_the_stop, name, nodes) as ours, _warm(published, name, nodes) as theirs:
        calls, calls_published = in_turns([ours, theirs], repeats)
    row = {
        "cost": calls[0]["cost"],
        "cost_published": calls_published[0]["cost"],
        "iterations": calls[0]["iterations"],
        "iterations_published": calls_published[0]["iterations"],
        "seconds": _median(calls),
        "seconds_published": _median(calls_published),
    }
    row["ratio"] = row["seconds_published"] / row["seconds"]
    echo(
        f"{name:18}{row['cost']:10.4f}{row['cost_published']:10.4f}{row['iterations']:7d}"
        f"{row['iterations_published']:7d}{1e3 * row['seconds']:10.1f}{1e3 * row['seconds_published']:10.1f}"
        f"{row['ratio']:8.2f}"
    )
    return row


def to_optimum(name: str, nodes: int, repeats: int, echo: Callable[[str], None]) -> dict[str, Any]:
    """Figures of the default mode's whole plan, of the published stack to its stop, and of IPOPT's solve.

    The default mode's time includes guess and certificate.
    """
    with _warm(ours_to_the_optimum, name, nodes) as ours, _warm(published, name, nodes) as theirs:
        calls, calls_published = in_turns([ours, theirs], repeats)
    with Apart(ipopt, name, nodes) as best:
        (starts,) = in_turns([best], 1)
    start, seconds, seconds_published = starts[0], _median(calls), _median(calls_published)
    echo(
        f"to the optimum, {nodes} nodes: ours {calls[0]['cost']:.4f} ({calls[0]['status']}) in "
        f"{1e3 * seconds:.1f} ms, the published stack to its stop in {1e3 * seconds_published:.1f} ms,"
    )
    echo(
        f"IPOPT {start['cost']:.4f} ({start['status']}, {start['iterations']} iterations) in "
        f"{start['seconds']:.2f} s"
    )
    solved = start["status"] == "Solve_Succeeded"
    return {
        "status": calls[0]["status"],
        "cost": calls[0]["cost"],
        "cost_ipopt": start["cost"],
        "same_cost": solved and abs(start["cost"] / calls[0]["cost"] - 1.0) < SAME_COST,
        "seconds": seconds,
        "seconds_published": seconds_published,
        "seconds_ipopt": start["seconds"],
        "ipopt": start,
    }


def _warm(make: Callable[..., Callable[[], dict[str, Any]]], *args: Any) -> Apart:
    return Apart(make, *args, calls=CALLS)


def _median(calls: list[dict[str, Any]]) -> float:
    return float(np.median([call["seconds"] for call in calls]))


# These run in separate processes. Each makes a function that plans once and returns the time.


def ours_to_the_stop(name: str, nodes: int) -> Callable[[], dict[str, Any]]:
    """The paper's mode, without guess and certificate."""
    from benchmarks.rivals.convert import as_arrays, as_method, as_problem

    arrays = as_arrays(MISSIONS[name](), nodes)
    solve, (problem, z) = jax.jit(as_method(arrays).run), as_problem(arrays)
    found = jax.block_until_ready(solve(problem, z))

    def plan():
        seconds = elapsed(lambda: solve(problem, z))
        return {"seconds": seconds, "cost": float(found.cost), "iterations": int(found.iterations)}

    return plan


def published(name: str, nodes: int) -> Callable[[], dict[str, Any]]:
    """The published stack."""
    from benchmarks.rivals import paper
    from benchmarks.rivals.convert import as_arrays

    arrays = as_arrays(MISSIONS[name](), nodes)

    def plan():
        iterations = paper.solve(arrays).iterations
        seconds = sum(i.discretise_seconds + i.setup_seconds + i.solver_seconds for i in iterations)
        return {"seconds": seconds, "cost": float(iterations[-1].cost), "iterations": len(iterations)}

    return plan


def ours_to_the_optimum(name: str, nodes: int) -> Callable[[], dict[str, Any]]:
    """The default mode, as a user calls the planner."""
    planner, scenario = Planner(nodes=nodes), MISSIONS[name]()
    found = planner(scenario)

    def plan():
        seconds = elapsed(lambda: planner(scenario))
        return {"seconds": seconds, "cost": float(found.cost), "status": str(status_names(found.status))}

    return plan


def ipopt(name: str, nodes: int) -> Callable[[], dict[str, Any]]:
    """IPOPT on the identical transcription, from the guess."""
    from benchmarks.rivals.convert import as_arrays
    from benchmarks.rivals.optimum import Optimum

    optimum = Optimum(as_arrays(MISSIONS[name](), nodes))
    return lambda: dataclasses.asdict(optimum.solve(1)[0])
