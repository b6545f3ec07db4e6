"""Our planner and the published stack on the same two missions, in one run: ``python -m benchmarks.planning``.

Both solve the paper's problem by the paper's method to the same stop, from the same guess: CVXPY (DPP), CLARABEL
and a Numba discretisation on one side, ``jaxscp`` on the other. Times are medians of warm solves.
"""

import argparse
import json
import time

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxscp  # noqa: E402
from benchmarks.rivals import paper  # noqa: E402
from benchmarks.rivals.convert import as_arrays, as_method, as_problem  # noqa: E402
from jaxscp.allocation import allocate  # noqa: E402
from jaxscp.initial_guess import initial_guess  # noqa: E402

MISSIONS = {
    "platform": jaxscp.scenarios.platform_to_platform,
    "ascend": jaxscp.scenarios.ascent_to_platform,
}


def median_seconds(function, repeats: int) -> float:
    """Median time of a call that ends when its arrays are there."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def compare(name: str, nodes: int, repeats: int) -> dict:
    scenario = MISSIONS[name]()
    arrays = as_arrays(scenario, nodes)
    run, (problem, z) = jax.jit(as_method(arrays).run), as_problem(arrays)
    start = time.perf_counter()
    ours = jax.block_until_ready(run(problem, z))
    compile_seconds = time.perf_counter() - start
    guess = jax.jit(
        lambda s: initial_guess(s, allocate(s.corridor, s.start.position, s.goal.position, nodes))
    )
    jax.block_until_ready(guess(scenario))
    theirs = [paper.solve(arrays) for _ in range(repeats)]
    our_seconds = median_seconds(lambda: run(problem, z), repeats)
    their_seconds = float(np.median([sum(_seconds(i) for i in r.iterations) for r in theirs]))
    return {
        "mission": name,
        "cost": float(ours.cost),
        "cost_published": float(theirs[0].iterations[-1].cost),
        "iterations": int(ours.iterations),
        "iterations_published": len(theirs[0].iterations),
        "seconds": our_seconds,
        "seconds_published": their_seconds,
        "ratio": their_seconds / our_seconds,
        "compile_seconds": compile_seconds,
        "guess_seconds": median_seconds(lambda: guess(scenario), 5 * repeats),
    }


def _seconds(iteration) -> float:
    return iteration.discretise_seconds + iteration.setup_seconds + iteration.solver_seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--nodes", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=7)
    options = parser.parse_args()
    rows = [compare(name, options.nodes, options.repeats) for name in MISSIONS]
    if options.json:
        print(json.dumps(rows))
        return
    print(
        f"{'':10}{'cost':>18}{'subproblems':>14}{'warm solve ms':>18}{'ratio':>8}{'compile s':>11}{'guess ms':>10}"
    )
    print(f"{'':10}{'ours':>9}{'published':>9}{'ours':>6}{'publ.':>8}{'ours':>9}{'publ.':>9}")
    for r in rows:
        print(
            f"{r['mission']:10}{r['cost']:9.4f}{r['cost_published']:9.4f}{r['iterations']:6d}"
            f"{r['iterations_published']:8d}{1e3 * r['seconds']:9.1f}{1e3 * r['seconds_published']:9.1f}"
            f"{r['ratio']:8.1f}{r['compile_seconds']:11.1f}{1e3 * r['guess_seconds']:10.2f}"
        )


if __name__ == "__main__":
    main()
