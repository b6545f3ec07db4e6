"""Gradients of plans: comparison with central differences, and their time and memory.

    python -m benchmarks.gradients [--json] [--instances 25] [--chunk 26] [--batch 0] [--repeats 7] [--gpu]

The instances are both missions and random variations of them. Each float leaf of the scenario is moved along a random
direction of the leaf's own size. The problem is solved again at two points on either side. Central differences of
fourth order are compared with the implicit derivative, for cost, flight time and three random functions of the
trajectory. The interior point solves the problem at the plan's mu, from the solution that the derivative predicts. From
another start it may converge to another of many optima.

The curvature of some plans is a thousand times larger than of others. There are four stencils; the stencil counts
whose differences of second and fourth order agree best. A pair of instance and leaf is left out in two cases. First,
the set of active constraints (multiplier above slack) differs between the points of a stencil. Second, the problem has
no solution at one of these points: a goal on the floor of its corridor, moved out of the corridor, for example.

The last figures are time and memory of a gradient, relative to the plan alone; with ``--batch``, also in a batch.
"""

import argparse
import functools
import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402
from benchmarks.speed.timing import elapsed, median_seconds  # noqa: E402
from jaxscp import LandingScenario, scenarios  # noqa: E402
from jaxscp.landing.places import leg_of  # noqa: E402
from jaxscp.landing.problem import landing_problem  # noqa: E402
from jaxscp.landing.units import in_units, units_of  # noqa: E402
from jaxscp.nlp.central_path import MU, Point  # noqa: E402
from jaxscp.nlp.interior_point import NLPInteriorPoint  # noqa: E402
from jaxscp.nlp.sensitivity import implicit_solution  # noqa: E402
from jaxscp.problem.form import Continuous  # noqa: E402
from jaxscp.problem.lowering import over_scaled_time  # noqa: E402
from jaxscp.problem.node_values import node_times  # noqa: E402
from jaxscp.transcription.shooting import evaluate  # noqa: E402
from tests.support.random_instances import random_instances, with_time_weight  # noqa: E402

NODES = 30
STEPS = (1e-5, 1e-6, 1e-7, 2e-8)  # relative to a leaf's size; a goal on a floor has a slack of a micrometre
STENCIL = np.array([1.0, -1.0, 2.0, -2.0])  # steps
FOURTH, SECOND = np.array([8.0, -8.0, -1.0, 1.0]) / 12.0, np.array([1.0, -1.0, 0.0, 0.0]) / 2.0  # orders
# solves the problem again, to the limit of rounding
AGAIN = NLPInteriorPoint(initial_mu=MU, tolerance=1e-12, max_steps=10)
SOLVED = 1e-8  # largest residual of a solved problem, as in the planner
# relative to the largest derivative of an output over all leaves: the scale of errors of smaller derivatives
SMALLEST = 1e-3
MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
CHUNK = 4096  # batch elements planned at once; larger batches are split
METHOD = jaxscp.NewtonSCP()
PLANNER = jaxscp.Planner(nodes=NODES, method=METHOD)


def instances(mission: str, count: int) -> LandingScenario:
    """A mission and random variations of it, as a batch."""
    base = with_time_weight(MISSIONS[mission](), 1.0)
    drawn = random_instances(jax.random.key(7), max(count, 1), lambda: base)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b[:count]]), base, drawn)


def leaves(scenario: LandingScenario) -> list[str]:
    """Names of the float leaves."""
    paths, _ = jax.tree_util.tree_flatten_with_path(scenario)
    return [jax.tree_util.keystr(path).lstrip(".") for path, _ in paths]


def direction(key, scenario: LandingScenario, leaf: Any) -> LandingScenario:
    """A random change of one leaf, of the leaf's size; an attitude keeps its norm."""
    flat, structure = jax.tree.flatten(scenario)
    names = leaves(scenario)

    def change(i, value):
        drawn = jax.random.normal(jax.random.fold_in(key, i), value.shape, value.dtype)
        if names[i].endswith("attitude"):
            drawn -= value * jnp.vdot(value, drawn)
        size = jnp.max(jnp.abs(value))
        size = jnp.where(size > 0.0, size, 1.0)
        return jnp.where(leaf == i, size * drawn / jnp.sqrt(value.size), 0.0)

    return structure.unflatten([change(i, value) for i, value in enumerate(flat)])


def problem_of(scenario, solution):
    """The scenario's problem over scaled time, with the intervals allocated as in the solution."""
    return over_scaled_time(landing_problem(scenario, leg_of(solution.context)), Continuous())


def outputs(problem, z):
    """Cost, flight time, and three random functions of the trajectory."""
    cost = jnp.sum(evaluate(problem, z, METHOD.grid).cost) + problem.terminal_cost(z)
    mix = jax.random.normal(jax.random.key(3), (3, *z.shape), z.dtype) / jnp.sqrt(z.size)
    return jnp.concatenate([jnp.stack([cost, node_times(z[:, -1])[-1]]), jnp.einsum("knv,nv->k", mix, z)])


def implicit(scenario, solution, change):
    """Derivatives of the outputs and of the optimum along a change of the scenario."""
    point = Point(solution.z, solution.multipliers)

    def of(scenario):
        problem = problem_of(scenario, solution)
        found = implicit_solution(problem, point, METHOD.grid, solution.differentiable)
        return outputs(problem, found.z), found

    return jax.jvp(of, (scenario,), (change,))[1]


def again(scenario, solution, change, predicted, length):
    """Outputs of the changed problem, solved again; the active set; whether the solver converged."""
    moved, z = (
        jax.tree.map(lambda a, b: a + length * b, *pair)
        for pair in ((scenario, change), (solution.z, predicted.z))
    )
    problem = problem_of(moved, solution)
    end = AGAIN.run(problem, z, solution.multipliers, METHOD.grid)
    active = jnp.concatenate([(y > s).ravel() for y, s in zip(end.y.values, end.slack, strict=True)])
    return outputs(problem, end.z), active, end.error <= SOLVED


def one(scenario, solution, leaf, key):
    """The derivative; for each stencil the difference, its estimated error, and flags: same active set, all solved."""
    change = direction(key, scenario, leaf)
    derivative, predicted = implicit(scenario, solution, change)

    def difference(step):
        solve = lambda steps: again(scenario, solution, change, predicted, step * steps)  # noqa: E731
        values, active, solved = jax.vmap(solve)(jnp.asarray(STENCIL))
        slope, rougher = FOURTH @ values / step, SECOND @ values / step
        return slope, slope - rougher, jnp.all(active == active[0]), jnp.all(solved)

    return derivative, *jax.lax.map(difference, jnp.array(STEPS))


def compare(mission: str, count: int, chunk: int, echo: Any) -> dict[str, Any]:
    """Derivatives compared with differences, for every leaf of every instance."""
    # In the solver's own units: ``problem_of`` then has the variables and multipliers of the solution.
    batch = jax.vmap(lambda s: in_units(s, units_of(s)))(instances(mission, count))
    solutions = jax.vmap(PLANNER)(batch)
    names = leaves(batch)
    pairs = [(i, leaf) for i in range(count + 1) for leaf in range(len(names))]
    run = jax.jit(jax.vmap(one))
    rows: list[Any] = []
    for first in range(0, len(pairs), chunk):
        some = [pairs[min(first + k, len(pairs) - 1)] for k in range(chunk)]
        index = np.array([i for i, _ in some])
        picked = jax.tree.map(lambda v, index=index: v[index], (batch, solutions))
        keys = jax.vmap(jax.random.key)(np.array([1000 * i + leaf for i, leaf in some]))
        found = run(*picked, np.array([leaf for _, leaf in some]), keys)
        rows += list(zip(*map(np.asarray, found), strict=True))[: len(pairs) - first]
    derivative, slopes, doubts, stays, solved = (np.stack(part) for part in zip(*rows, strict=True))
    instance, leaf = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    differentiable = np.asarray(solutions.differentiable)
    usable = stays & solved & differentiable[instance, None]
    compared = usable.any(axis=1)
    # largest derivative of each output over all leaves; below a thousandth of it, errors are relative to it
    largest = np.max(np.abs(derivative[compared]), axis=0)
    doubt = np.where(usable, np.linalg.norm(doubts / largest, axis=2), np.inf)
    slope = np.take_along_axis(slopes, np.argmin(doubt, axis=1)[:, None, None], axis=1)[:, 0]
    size = np.maximum(np.linalg.norm(slope / largest, axis=1), SMALLEST)
    error = np.linalg.norm((derivative - slope) / largest, axis=1) / size
    echo(f"{mission}: {np.sum(differentiable)} of {count + 1} plans differentiable")
    echo(f"{'leaf':34} {'pairs':>5} {'worst error':>12} {'median':>9} {'largest derivative':>19}")
    for k, name in enumerate(names):
        which = compared & (leaf == k)
        if which.any():
            strength = np.max(np.linalg.norm(derivative[which] / largest, axis=1))
            echo(
                f"{name:34} {which.sum():5d} {error[which].max():12.1e} {np.median(error[which]):9.1e} {strength:19.1e}"
            )
    worst = [
        {"instance": int(instance[i]), "leaf": names[leaf[i]], "error": float(error[i])}
        for i in np.argsort(np.where(compared, -error, np.inf))[:10]
    ]
    echo("worst: " + ", ".join(f"{w['leaf']} of {w['instance']} {w['error']:.1e}" for w in worst))
    return {
        "worst": worst,
        "max_relative_error": float(error[compared].max()),
        "fraction_within_1e-4": float(np.mean(error[compared] <= 1e-4)),
        "excluded_fraction": float(1.0 - np.mean(compared)),
        "active_set_changes": int(np.sum((solved & ~stays).all(axis=1))),
        "not_solved_again": int(np.sum(~solved.any(axis=1))),
        "differentiable_fraction": float(np.mean(differentiable)),
        "pairs": len(pairs),
    }


def translation(echo: Any) -> float:
    """Gradient along a translation of the whole scene: zero except for rounding."""
    worst = 0.0
    for mission in MISSIONS.values():
        floats, rest = eqx.partition(with_time_weight(mission(), 1.0), eqx.is_inexact_array)
        g = jax.jit(jax.grad(lambda f, rest=rest: PLANNER(eqx.combine(f, rest)).final_time))(floats)
        faces = jnp.einsum("pf,pfc->c", g.corridor.offsets, floats.corridor.normals)
        worst = max(worst, float(jnp.max(jnp.abs(g.start.position + g.goal.position + faces))))
    echo(f"translation of the whole scene: residual {worst:.1e}")
    return worst


def cost_of_gradients(batch_size: int, repeats: int, echo: Any) -> dict[str, Any]:
    """Relative increase of time and memory of plans if the gradient of the flight time is added."""
    base = with_time_weight(scenarios.platform_to_platform(), 1.0)
    if batch_size:
        base = jax.tree.map(lambda v: v[1:], instances("platform", batch_size))
    floats, rest = eqx.partition(base, eqx.is_inexact_array)

    def plan(floats):
        one = lambda parts: PLANNER(eqx.combine(*parts))  # noqa: E731
        found = jax.lax.map(one, (floats, rest), batch_size=CHUNK) if batch_size else one((floats, rest))
        return jnp.sum(found.final_time), found

    functions = {"plan": plan, "with its gradient": jax.value_and_grad(plan, has_aux=True)}
    with ThreadPoolExecutor() as pool:  # compile both at once
        programs = pool.map(lambda function: jax.jit(function).lower(floats).compile(), functions.values())
    figures = {}
    for name, compiled in zip(functions, programs, strict=True):
        memory: Any = compiled.memory_analysis()
        call = functools.partial(compiled, floats)
        # a batch takes minutes, and its first run hardly longer than later runs
        seconds = elapsed(call) if batch_size else median_seconds(call, repeats)
        figures[name] = (seconds, memory.temp_size_in_bytes + memory.output_size_in_bytes)
        echo(
            f"{batch_size or 1} at once, {name}: {figures[name][0]:.3f} s, {figures[name][1] / 2**20:.1f} MiB"
        )
    (plain, bytes_plain), (more, bytes_more) = figures.values()
    return {
        "time_ratio": more / plain - 1.0,
        "memory_ratio": bytes_more / bytes_plain - 1.0,
        "plan_seconds": plain,
    }


def main() -> None:
    """Compare, then measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--instances", type=int, default=25, help="random ones of each mission; 0: no differences"
    )
    parser.add_argument("--chunk", type=int, default=26, help="differences made at once")
    parser.add_argument("--batch", type=int, default=0, help="plans at once, whose gradient is timed as well")
    parser.add_argument("--repeats", type=int, default=7, help="of a timed plan; 0: none")
    parser.add_argument(
        "--gpu", action="store_true", help="the gradient of 4096 plans at once is timed as well"
    )
    options = parser.parse_args()
    batch_size = 4096 if options.gpu else options.batch

    def echo(line: str) -> None:
        print(line, flush=True) if not options.json else None

    result: dict[str, Any] = {}
    if options.instances:
        parts = {mission: compare(mission, options.instances, options.chunk, echo) for mission in MISSIONS}
        pairs = sum(part["pairs"] for part in parts.values())
        result["max_relative_error"] = max(part["max_relative_error"] for part in parts.values())
        result["excluded_fraction"] = sum(p["excluded_fraction"] * p["pairs"] for p in parts.values()) / pairs
        result["translation_residual"] = translation(echo)
        result["missions"] = parts
    if options.repeats:
        result |= cost_of_gradients(0, options.repeats, echo)
    if batch_size:
        result["batched"] = {"batch": batch_size, **cost_of_gradients(batch_size, 1, echo)}
    if options.json:
        print(json.dumps(result))
    else:
        echo("\n".join(f"{k}: {v}" for k, v in result.items()))


if __name__ == "__main__":
    main()
