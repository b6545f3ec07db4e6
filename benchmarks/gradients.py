"""Gradients of plans: against central differences of the problem solved again, and what they cost.

    python -m benchmarks.gradients [--json] [--instances 25] [--chunk 26] [--lanes 0] [--repeats 7] [--gpu]

For both missions and random variations of them: every float leaf of the scenario is moved along a random direction of
its own size, the problem is solved again at two points on either side (by the interior point, from the plan at hand),
and the central differences, of fourth order, of cost, flight time and three random functions of the trajectory are
compared with the implicit derivative. An instance and leaf are left out where the set of active constraints (price
above slack) differs between those points, or the problem has no solution at one of them (a goal on the floor of its
corridor, moved out of it). Then the time and memory of a gradient, relative to the plan alone; with ``--lanes``, in a
batch too.
"""

import argparse
import json
import time
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402
from jaxscp import LandingScenario, scenarios  # noqa: E402
from jaxscp.central_path import Point  # noqa: E402
from jaxscp.convexify import terminal_cost  # noqa: E402
from jaxscp.interior import Interior  # noqa: E402
from jaxscp.intervals import evaluate  # noqa: E402
from jaxscp.landing import landing_problem  # noqa: E402
from jaxscp.problem import node_times  # noqa: E402
from jaxscp.sensitivity import follow  # noqa: E402
from tests.random_instances import bare, random_instances  # noqa: E402

NODES = 30
STEP = 1e-5  # of a leaf's size
STENCIL = {1: 8.0 / 12.0, -1: -8.0 / 12.0, 2: -1.0 / 12.0, -2: 1.0 / 12.0}  # steps: weight; of fourth order
AGAIN = Interior(first=1e-5, tolerance=1e-9)  # the problem solved again, from near
SMALLEST = (
    1e-3  # of the largest derivative of an output over all leaves: smaller ones are judged relative to that
)
MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
METHOD = jaxscp.NewtonSCP()
PLANNER = jaxscp.Planner(nodes=NODES, method=METHOD)


def instances(mission: str, count: int) -> LandingScenario:
    """A mission and random variations of it, as a batch."""
    base = bare(MISSIONS[mission](), 1.0)
    drawn = random_instances(jax.random.key(7), max(count, 1), lambda: base)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b[:count]]), base, drawn)


def leaves(scenario: LandingScenario) -> list[str]:
    """Names of the float leaves."""
    paths, _ = jax.tree_util.tree_flatten_with_path(scenario)
    return [jax.tree_util.keystr(path).lstrip(".") for path, _ in paths]


def direction(key, scenario: LandingScenario, leaf: Any) -> LandingScenario:
    """A random change of one leaf, of its own size; an attitude keeps its norm."""
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


def outputs(problem, z):
    """Cost, flight time, and three random functions of the trajectory."""
    cost = jnp.sum(evaluate(problem, z, METHOD.grid).cost) + terminal_cost(problem, z)
    mix = jax.random.normal(jax.random.key(3), (3, *z.shape), z.dtype) / jnp.sqrt(z.size)
    return jnp.concatenate([jnp.stack([cost, node_times(z[:, -1])[-1]]), jnp.einsum("knv,nv->k", mix, z)])


def implicit(scenario, solution, change):
    """Derivative of the outputs along a change of the scenario."""
    y = solution.multipliers
    point = Point(solution.z, y.flow, y.initial, y.final)

    def of(scenario):
        problem = landing_problem(scenario, solution.allocation)
        return outputs(problem, follow(problem, point, METHOD.grid, solution.differentiable).z)

    return jax.jvp(of, (scenario,), (change,))[1]


def again(scenario, solution, change, length):
    """Outputs of the changed problem, solved again; the active set; and whether that ended well."""
    moved = jax.tree.map(lambda a, b: a + length * b, scenario, change)
    problem = landing_problem(moved, solution.allocation)
    end = AGAIN.run(problem, solution.z, solution.multipliers, METHOD.grid)
    active = jnp.concatenate([(y > s).ravel() for y, s in zip(end.y.values, end.slack, strict=True)])
    return outputs(problem, end.z), active, AGAIN.reached(end)


def one(scenario, solution, leaf, key):
    """(derivative, difference, whether the active set stays, whether all points were solved)."""
    change = direction(key, scenario, leaf)
    lengths, weights = STEP * jnp.array([float(k) for k in STENCIL]), jnp.array(list(STENCIL.values()))
    values, active, solved = jax.vmap(lambda length: again(scenario, solution, change, length))(lengths)
    slope = weights @ values / STEP
    return implicit(scenario, solution, change), slope, jnp.all(active == active[0]), jnp.all(solved)


def compare(mission: str, count: int, chunk: int, echo: Any) -> dict[str, Any]:
    """Derivatives against differences, for every leaf of every instance."""
    batch = instances(mission, count)
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
    derivative, slope = (np.stack([row[k] for row in rows]) for k in (0, 1))
    stays, solved = (np.array([row[k] for row in rows]) for k in (2, 3))
    instance, leaf = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    differentiable = np.asarray(solutions.differentiable)
    kept = stays & solved & differentiable[instance]
    # of every output, the largest derivative of any leaf: below a thousandth of that, errors are relative to it
    largest = np.max(np.abs(derivative[kept]), axis=0)
    size = np.maximum(np.linalg.norm(slope / largest, axis=1), SMALLEST)
    error = np.linalg.norm((derivative - slope) / largest, axis=1) / size
    echo(f"{mission}: {np.sum(differentiable)} of {count + 1} plans differentiable")
    echo(f"{'leaf':34} {'kept':>5} {'worst error':>12} {'median':>9} {'largest derivative':>19}")
    for k, name in enumerate(names):
        which = kept & (leaf == k)
        if which.any():
            strength = np.max(np.linalg.norm(derivative[which] / largest, axis=1))
            echo(
                f"{name:34} {which.sum():5d} {error[which].max():12.1e} {np.median(error[which]):9.1e} {strength:19.1e}"
            )
    worst = [
        {"instance": int(instance[i]), "leaf": names[leaf[i]], "error": float(error[i])}
        for i in np.argsort(np.where(kept, -error, np.inf))[:10]
    ]
    echo("worst: " + ", ".join(f"{w['leaf']} of {w['instance']} {w['error']:.1e}" for w in worst))
    return {
        "worst": worst,
        "max_relative_error": float(error[kept].max()),
        "share_within_1e-4": float(np.mean(error[kept] <= 1e-4)),
        "excluded_share": float(1.0 - np.mean(kept)),
        "active_set_changes": int(np.sum(solved & ~stays)),
        "not_solved_again": int(np.sum(~solved)),
        "differentiable_share": float(np.mean(differentiable)),
        "pairs": len(pairs),
    }


def translation(echo: Any) -> float:
    """What is left of the gradients when the whole scene moves: zero, but for rounding."""
    worst = 0.0
    for mission in MISSIONS.values():
        floats, rest = eqx.partition(bare(mission(), 1.0), eqx.is_inexact_array)
        g = jax.jit(jax.grad(lambda f, rest=rest: PLANNER(eqx.combine(f, rest)).final_time))(floats)
        faces = jnp.einsum("pf,pfc->c", g.corridor.offsets, floats.corridor.normals)
        worst = max(worst, float(jnp.max(jnp.abs(g.start.position + g.goal.position + faces))))
    echo(f"translation of the whole scene: residual {worst:.1e}")
    return worst


def cost_of_gradients(lanes: int, repeats: int, echo: Any) -> dict[str, Any]:
    """Time and memory of a plan with its gradient, over those of the plan, less one."""
    base = bare(scenarios.platform_to_platform(), 1.0)
    if lanes:
        base = jax.tree.map(lambda v: v[1:], instances("platform", lanes))
    floats, rest = eqx.partition(base, eqx.is_inexact_array)

    def cost(floats):
        plan = lambda f, r: PLANNER(eqx.combine(f, r)).final_time  # noqa: E731
        return jnp.sum(jax.vmap(plan)(floats, rest)) if lanes else plan(floats, rest)

    figures = {}
    for name, function in (("plan", cost), ("with_gradient", jax.value_and_grad(cost))):
        compiled = jax.jit(function).lower(floats).compile()
        memory: Any = compiled.memory_analysis()
        jax.block_until_ready(compiled(floats))
        times = []
        for _ in range(repeats):
            began = time.perf_counter()
            jax.block_until_ready(compiled(floats))
            times.append(time.perf_counter() - began)
        figures[name] = (float(np.median(times)), memory.temp_size_in_bytes + memory.output_size_in_bytes)
    (plain, bytes_plain), (more, bytes_more) = figures["plan"], figures["with_gradient"]
    echo(
        f"{lanes or 1} at once: plan {plain:.3f} s, {bytes_plain / 2**20:.1f} MiB; with its gradient {more:.3f} s, "
        f"{bytes_more / 2**20:.1f} MiB"
    )
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
    parser.add_argument("--lanes", type=int, default=0, help="plans at once, whose gradient is timed as well")
    parser.add_argument("--repeats", type=int, default=7, help="of a timed plan; 0: none")
    parser.add_argument(
        "--gpu", action="store_true", help="the gradient of 4096 plans at once is timed as well"
    )
    wanted = parser.parse_args()
    lanes = 4096 if wanted.gpu else wanted.lanes

    def echo(line: str) -> None:
        print(line, flush=True) if not wanted.json else None

    result: dict[str, Any] = {}
    if wanted.instances:
        parts = {mission: compare(mission, wanted.instances, wanted.chunk, echo) for mission in MISSIONS}
        pairs = sum(part["pairs"] for part in parts.values())
        result["max_relative_error"] = max(part["max_relative_error"] for part in parts.values())
        result["excluded_share"] = sum(p["excluded_share"] * p["pairs"] for p in parts.values()) / pairs
        result["translation_residual"] = translation(echo)
        result["missions"] = parts
    if wanted.repeats:
        result |= cost_of_gradients(0, wanted.repeats, echo)
    if lanes:
        result["batched"] = {"lanes": lanes, **cost_of_gradients(lanes, 1, echo)}
    if wanted.json:
        print(json.dumps(result))
    else:
        echo("\n".join(f"{k}: {v}" for k, v in result.items()))


if __name__ == "__main__":
    main()
