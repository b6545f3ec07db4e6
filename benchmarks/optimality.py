"""Cost, violations and number of subproblems: jaxscp compared with CasADi and IPOPT.

The suite: both missions, an L-shaped and the three-box corridor, a moving deck, a keep-out ball, and random variations
of the missions. Each has w_t = 0 and w_t = 5. IPOPT solves the identical transcription (same nodes, points between the
nodes, and margins) from four starts. jaxscp starts from the standard guess alone. The paper's method also solves the
first cases.

IPOPT takes most of the time and does not depend on jaxscp. ``--reference FILE`` caches IPOPT's results. They are read
again if the file has results for the same problems and starts.

    python -m benchmarks.optimality [--json] [--instances 40] [--starts 4] [--workers 2] [--reference FILE]
"""

import argparse
import dataclasses
import hashlib
import json
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402
from benchmarks.rivals.convert import as_arrays  # noqa: E402
from benchmarks.rivals.optimum import Extras, Optimum, Start, best  # noqa: E402
from benchmarks.rivals.problem import LandingArrays  # noqa: E402
from jaxscp import LandingScenario, scenarios, status_names  # noqa: E402
from jaxscp.corridor.polytopes import Corridor, box, connect  # noqa: E402
from tests.support.random_instances import PRICES, bare, random_instances  # noqa: E402

NODES = 30
PERCENT = {"share_within_0.1_percent": 1e-3, "share_within_1_percent": 1e-2}
BALL, BALL_RADIUS = (5.2, 0.4, 2.6), 0.6  # m: the ball lies on the path of both optima without the ball
DECK_VELOCITY = (0.3, -0.1, 0.1)
BOTH_METHODS = 8  # number of first cases; the paper's method can state these
NO_EXTRAS = Extras()
DISTANCES = ("corridor", "landing cone", "keep-out")


@dataclasses.dataclass(frozen=True)
class Case:
    """One problem of the suite."""

    name: str
    scenario: LandingScenario
    extras: Extras = NO_EXTRAS


def l_shaped() -> LandingScenario:
    """One right-angled corner, 4 m and then 5 m long."""
    corridor = connect(
        [box([-1.0, -1.0, 0.5], [5.0, 1.0, 3.0]), box([3.0, -1.0, 0.5], [5.0, 6.0, 3.0])],
        joints=[[4.0, 0.0, 1.5]],
    )
    return _through(corridor, [0.0, 0.0, 1.0], [4.0, 5.0, 1.0])


def three_box() -> LandingScenario:
    """Two right-angled corners."""
    boxes = [
        box([-1.0, -1.0, -0.2], [4.2, 1.2, 3.0]),
        box([2.8, -1.0, -0.2], [4.2, 5.2, 3.0]),
        box([2.8, 3.8, -0.2], [9.0, 5.2, 3.0]),
    ]
    return _through(
        connect(boxes, joints=[[3.5, 0.2, 1.5], [3.5, 4.5, 1.5]]), [0.0, 0.0, 1.0], [8.0, 4.5, 0.5]
    )


def _through(corridor: Corridor, start, goal) -> LandingScenario:
    base = scenarios.ascent_to_platform()
    ends = jaxscp.at_rest(start), jaxscp.at_rest(goal)
    return eqx.tree_at(lambda s: (s.start, s.goal, s.corridor), base, (*ends, corridor))


def suite(instances: int) -> list[Case]:
    """Every case, at every time weight."""
    missions = [scenarios.platform_to_platform, scenarios.ascent_to_platform]
    platform, ascend = (mission() for mission in missions)
    ball = jaxscp.ellipsoids([BALL], BALL_RADIUS)
    deck = dataclasses.replace(ascend, deck_velocity=jnp.array(DECK_VELOCITY))
    cases = [
        Case("platform", platform),
        Case("ascend", ascend),
        Case("L-shaped", l_shaped()),
        Case("three-box", three_box()),
        Case("moving deck", deck, Extras(deck_velocity=DECK_VELOCITY)),
        Case(
            "keep-out ball",
            dataclasses.replace(platform, keep_out=ball),
            Extras(ball=BALL, ball_radius=BALL_RADIUS),
        ),
    ]
    half = -(-instances // 2)
    for name, mission, count in zip(("platform", "ascend"), missions, (half, instances - half), strict=True):
        batch = random_instances(jax.random.key(1), max(count, 1), mission)
        cases += [Case(f"{name} {i}", jax.tree.map(lambda v, i=i: v[i], batch)) for i in range(count)]
    return [
        dataclasses.replace(case, name=f"{case.name}, w_t {price:g}", scenario=bare(case.scenario, price))
        for case in cases
        for price in PRICES
    ]


@dataclasses.dataclass(frozen=True)
class Ours:
    """Result of jaxscp's planner for a case."""

    status: str
    cost: float
    iterations: int
    seconds: float
    violation: float
    """Worst violation of corridor, cone and keep-out zone, densely between the nodes, m."""
    limits: float
    """Worst violation of all other limits, relative to the allowed violation."""
    optimality: float | None
    """Residual of the optimality conditions, from the certificate."""


def plan(planner: jaxscp.Planner, scenario: LandingScenario) -> Ours:
    """Figures of one plan, timed; the planner must be compiled before."""
    began = time.perf_counter()
    solution = jax.block_until_ready(planner(scenario))
    seconds = time.perf_counter() - began
    certificate = solution.certificate
    between = dict(zip(certificate.names, np.asarray(certificate.between_nodes), strict=True))
    allowed = dict(zip(certificate.names, np.asarray(certificate.allowed), strict=True))
    return Ours(
        status=str(status_names(solution.status)),
        cost=float(solution.cost),
        iterations=int(solution.iterations),
        seconds=seconds,
        violation=max((float(v) for n, v in between.items() if n in DISTANCES), default=0.0),
        limits=max((float(v / allowed[n]) for n, v in between.items() if n not in DISTANCES), default=0.0),
        optimality=None if certificate.optimality is None else float(certificate.optimality),
    )


def reference(arrays: LandingArrays, extras: Extras, starts: int) -> list[Start]:
    """IPOPT's results, one for each start; runs in a worker process."""
    return Optimum(arrays, extras).solve(starts)


def arrays_of(scenario: LandingScenario) -> LandingArrays:
    """The scenario as the rivals' arrays, without the features in ``Extras``."""
    return as_arrays(dataclasses.replace(scenario, keep_out=None, deck_velocity=None), NODES)


def references(cases: list[Case], starts: int, workers: int, file: Path | None) -> list[list[Start]]:
    """IPOPT's results for every case and start, from the file if they are there."""
    problems = [arrays_of(case.scenario) for case in cases]
    keys = [_fingerprint(p, c.extras, starts) for p, c in zip(problems, cases, strict=True)]
    kept = json.loads(file.read_text()) if file and file.exists() else {}
    missing = [i for i, key in enumerate(keys) if key not in kept]
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        tasks = [pool.submit(reference, problems[i], cases[i].extras, starts) for i in missing]
        for i, task in zip(missing, tasks, strict=True):
            kept[keys[i]] = [dataclasses.asdict(start) for start in task.result()]
            if file:
                file.write_text(json.dumps(kept, indent=1))
    return [[Start(**start) for start in kept[key]] for key in keys]


def _fingerprint(problem: LandingArrays, extras: Extras, starts: int) -> str:
    """Hash of IPOPT's problem without the first guess, rounded so that all processors agree."""
    guess = ("states", "controls", "dilation")
    fields = [np.ravel(np.asarray(v, float)) for name, v in vars(problem).items() if name not in guess]
    numbers = [f"{x + 0.0:.9f}" for x in np.round(np.concatenate(fields), 9)]
    return hashlib.sha256(" ".join([*numbers, repr(extras), str(starts)]).encode()).hexdigest()


def compile_for(planner: jaxscp.Planner, cases: list[Case]) -> None:
    """Plan one case of every shape, so that later times contain no compilation."""
    shapes = {str(jax.tree.map(jnp.shape, case.scenario)): case.scenario for case in cases}
    for scenario in shapes.values():
        plan(planner, scenario)


def compare(instances: int, starts: int, workers: int, file: Path | None, echo: Any) -> dict[str, Any]:
    """Figures of the suite by IPOPT and by jaxscp, and of its first cases by the paper's method."""
    cases, planner = suite(instances), jaxscp.Planner(nodes=NODES)
    found = references(cases, starts, workers, file)
    compile_for(planner, cases)
    echo(
        f"{'case':24} {'status':22} {'ours':>8} {'IPOPT':>8} {'gap %':>7} {'subpr.':>6} {'iter.':>6} "
        f"{'s':>6} {'s':>6} {'violation mm':>12}"
    )
    rows, plans = [], []
    for case, theirs in zip(cases, found, strict=True):
        mine = plan(planner, case.scenario)
        plans.append(mine)
        optimum = best(theirs)
        gap = mine.cost / optimum - 1.0
        rows.append({"case": case.name, "gap": gap, "optimum": optimum, **dataclasses.asdict(mine)})
        echo(
            f"{case.name:24} {mine.status:22} {mine.cost:8.4f} {optimum:8.4f} {100 * gap:7.3f} "
            f"{mine.iterations:6d} {theirs[0].iterations:6d} {mine.seconds:6.2f} {theirs[0].seconds:6.1f} "
            f"{1e3 * mine.violation:12.3f}"
        )
    good = [row for row in rows if row["status"] == "converged"]
    counts = [row["iterations"] for row in rows]
    shares = {name: sum(row["gap"] <= share for row in good) / len(rows) for name, share in PERCENT.items()}
    return {
        **shares,
        "median_iterations": float(np.median(counts)),
        "p95_iterations": float(np.percentile(counts, 95)),
        "worst_violation_m": max((row["violation"] for row in good), default=0.0),
        "worst_limit_relative_to_allowed": max((row["limits"] for row in good), default=0.0),
        "worst_optimality_residual": max((row["optimality"] for row in good), default=0.0),
        "converged": len(good),
        "cases": rows,
        "paper": before_and_after(cases[:BOTH_METHODS], plans[:BOTH_METHODS], echo),
    }


def before_and_after(cases: list[Case], plans: list[Ours], echo: Any) -> list[dict[str, Any]]:
    """Costs and violations between the nodes of the paper's method and of the default, same guess."""
    published = jaxscp.Planner(nodes=NODES, method=jaxscp.PTR())
    compile_for(published, cases)
    echo(f"{'':24} {'paper':>8} {'ours':>8} {'paper mm':>9} {'ours mm':>8}")
    rows = []
    for case, after in zip(cases, plans, strict=True):
        before = plan(published, case.scenario)
        rows.append(
            {
                "case": case.name,
                "before": dataclasses.asdict(before),
                "after": dataclasses.asdict(after),
            }
        )
        echo(
            f"{case.name:24} {before.cost:8.3f} {after.cost:8.3f} {1e3 * before.violation:9.1f} "
            f"{1e3 * after.violation:8.3f}"
        )
    return rows


def main() -> None:
    """Run the comparison and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--instances", type=int, default=40, help="random ones in the suite")
    parser.add_argument("--starts", type=int, default=4, help="of IPOPT, for each case")
    parser.add_argument("--workers", type=int, default=2, help="processes for IPOPT")
    parser.add_argument("--reference", type=Path, help="JSON file that keeps what IPOPT found")
    wanted = parser.parse_args()

    def echo(line: str) -> None:
        print(line, file=sys.stderr if wanted.json else sys.stdout, flush=True)

    result = compare(wanted.instances, wanted.starts, wanted.workers, wanted.reference, echo)
    if wanted.json:
        print(json.dumps(result))
    else:
        echo("\n".join(f"{k}: {v}" for k, v in result.items() if k not in ("cases", "paper")))


if __name__ == "__main__":
    main()
