"""A process of the comparison: it plans with the jaxscp of one folder, of whatever commit.

    python -P worker.py FOLDER TASK [ARGUMENTS as JSON]

The last line that a task prints is its answer, as JSON. The script imports nothing of this repository, so that the
same text serves both commits. Names that differ between commits appear in ``method`` and ``with_mass`` alone.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402

NODES = 30
BATCH = 8
MASSES = (0.85, 1.0)  # kg, of the batch's first and last vehicle
CASES = ("platform_to_platform", "ascent_to_platform")
MODES = ("default", "paper")


# --- names that differ between commits ---


def method(mode: str) -> Any:
    """Settings of a mode."""
    if mode == "default":
        return jaxscp.NewtonSCP()
    name = "PTR" if hasattr(jaxscp, "PTR") else "SCP"
    return getattr(jaxscp, name)()


def with_mass(scenario: Any, mass: Any) -> Any:
    """The scenario with another mass of the vehicle."""
    import equinox as eqx

    return eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass)


# --- parts of tasks ---


def planner(mode: str = "default") -> Any:
    return jaxscp.Planner(nodes=NODES, method=method(mode))


def case(name: str = CASES[0]) -> Any:
    return getattr(jaxscp.scenarios, name)()


def timed(function: Any, *args: Any) -> tuple[float, Any]:
    """Seconds of a call, and its result."""
    began = time.perf_counter()
    result = jax.block_until_ready(function(*args))
    return time.perf_counter() - began, result


def save(file: str, tree: Any) -> None:
    """All leaves by their names, in flattening order."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    np.savez(file, allow_pickle=False, **{jax.tree_util.keystr(path): np.asarray(v) for path, v in leaves})


def status(solution: Any) -> str:
    """Names of the statuses, without repetition."""
    names = np.atleast_1d(np.asarray(jaxscp.status_names(solution.status), dtype=object))
    return ", ".join(sorted({str(name) for name in names}))


# --- tasks ---


def plans(folder: str) -> dict[str, str]:
    """Both cases in both modes, a file each."""
    found = {}
    for mode in MODES:
        plan = planner(mode)
        for name in CASES:
            solution = plan(case(name))
            save(f"{folder}/{mode}, {name}.npz", solution)
            found[f"{mode}, {name}"] = status(solution)
    return found


def batch(file: str) -> dict[str, Any]:
    """A batch of the default mode; its first call compiles."""
    masses = jnp.linspace(*MASSES, BATCH)
    scenarios = jax.vmap(lambda mass: with_mass(case(), mass))(masses)
    seconds, solutions = timed(jax.jit(jax.vmap(planner())), scenarios)
    save(file, solutions)
    return {"status": status(solutions), "seconds": seconds}


def gradient(file: str) -> dict[str, str]:
    """Derivatives of final time and cost in every float of a scenario."""
    import equinox as eqx

    floats, rest = eqx.partition(case(), eqx.is_inexact_array)
    plan = planner()

    def mixture(floats: Any, parts: Any) -> Any:
        solution = plan(eqx.combine(floats, rest))
        return jnp.dot(parts, jnp.stack([solution.final_time, solution.cost])), solution

    function = jax.jit(jax.grad(mixture, has_aux=True))
    by_time, solution = function(floats, jnp.array([1.0, 0.0]))
    by_cost, _ = function(floats, jnp.array([0.0, 1.0]))
    save(file, {"final_time": by_time, "cost": by_cost})
    return {"status": status(solution)}


def export(file: str) -> dict[str, str]:
    """Write a planner to a file."""
    planner().export(file, case())
    return {}


def call_export(export: str, file: str) -> dict[str, str]:
    """Plan by an exported planner."""
    plan: Any = jaxscp.load(export)
    solution = plan(case())
    save(file, solution)
    return {"status": status(solution)}


def start(cache: str | None = None, export: str | None = None) -> dict[str, Any]:
    """The first plan of a process: with an empty or full cache, without one, or by an exported planner."""
    if cache:
        jaxscp.use_cache(cache)
    plan: Any = jaxscp.load(export) if export else planner()
    seconds, solution = timed(plan, case())
    return {"status": status(solution), "seconds": seconds}


def serve(mode: str, calls: int) -> dict[str, Any]:
    """Warm calls: a median of so many for every line of input, until that ends."""
    plan, scenario = planner(mode), case()
    seconds, solution = timed(plan, scenario)
    first = {"status": status(solution), "seconds": seconds}
    print(json.dumps(first), flush=True)
    for _ in sys.stdin:
        median = float(np.median([timed(plan, scenario)[0] for _ in range(calls)]))
        print(json.dumps(median), flush=True)
    return first


TASKS = {task.__name__: task for task in (plans, batch, gradient, export, call_export, start, serve)}


def main(folder: str, task: str, arguments: str = "{}") -> None:
    """Check which jaxscp it is, run the task and print its answer."""
    imported = Path(jaxscp.__file__).resolve()
    assert imported.is_relative_to(Path(folder).resolve()), (
        f"jaxscp was imported from {imported}, not {folder}"
    )
    print(json.dumps(TASKS[task](**json.loads(arguments))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
