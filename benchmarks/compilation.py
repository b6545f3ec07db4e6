"""Time of first and second calls: a first call compiles. Each row is a process of its own, without a cache.

    python -m benchmarks.compilation [--only ROW ...]

Imports and the preparation of a row, a plan to start a re-plan from say, are not in its times.
"""

import argparse
import json
import os
import subprocess
import sys

OWN = """
import jax.numpy as jnp

def car(x, u, t, p):
    return p * jnp.stack([jnp.cos(x[2]), jnp.sin(x[2]), u[0]])

def outside(x, u, t, disc):
    return jnp.linalg.norm(x[:2] - disc[:2])[None] - disc[2]

def solved(speed):
    problem = jaxscp.OptimalControlProblem(
        dynamics=jaxscp.Dynamics.of(car, states=3, controls=1, parameters=speed),
        cost=jaxscp.Cost(running=lambda x, u, t, p: 1.0 + 0.01 * u @ u),
        constraints=(
            jaxscp.bounds(control=(-1.0, 1.0)),
            jaxscp.Constraint(outside, jaxscp.NonNegative(), jnp.array([3.0, 0.2, 1.0])),
        ),
        boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0, 0.0]), jaxscp.fixed_state([6.0, 0.0, None])),
        time=jaxscp.Time(nodes=30, final=jaxscp.FreeTime(1.0, 20.0)),
    )
    return jaxscp.solve(problem, jaxscp.straight_line(problem, final_time=6.0))
"""
LANDING = """
import dataclasses
import equinox as eqx
import jax.numpy as jnp
scenario = jaxscp.scenarios.platform_to_platform()
planner = jaxscp.Planner(nodes=30)
with_mass = lambda mass: eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass)
"""
PLANNED = LANDING + "solution = jax.block_until_ready(planner(scenario))\n"
FLYING = """
here = dataclasses.replace(scenario, start=jaxscp.BodyState.of(solution.trajectory.at(jnp.array([0.4])).state[0]))
"""
MASSES = "masses = jnp.array([0.8, 0.9, 1.0, 1.1])\n"
EXPORT = "import os, tempfile\nfile = os.path.join(tempfile.mkdtemp(), 'planner.jaxscp')\n"
ROWS = {  # name: (preparation, call)
    "a landing": (LANDING, "planner(scenario)"),
    "re-plan, after a landing": (PLANNED, "planner.replan(solution, scenario)"),
    "re-plan in flight, after a landing": (
        PLANNED + FLYING,
        "planner.replan(solution, here, elapsed=0.4)",
    ),
    "gradient of a landing": (LANDING, "jax.grad(lambda mass: planner(with_mass(mass)).final_time)(0.928)"),
    "four landings by jax.vmap": (
        LANDING + MASSES,
        "jax.vmap(lambda mass: planner(with_mass(mass)))(masses)",
    ),
    "four landings by planner.map": (LANDING + MASSES, "planner.map([with_mass(mass) for mass in masses])"),
    "export of a planner": (LANDING + EXPORT, "planner.export(file, scenario)"),
    "own problem, 3 states": (OWN, "solved(1.0)"),
    "gradient of the own problem": (OWN, "jax.grad(lambda speed: solved(speed).cost)(1.0)"),
}
BODY = """
import json, time, jax
jax.config.update("jax_enable_x64", True)
import jaxscp
{preparation}
times = []
for _ in range(2):
    began = time.perf_counter()
    jax.block_until_ready({call})
    times.append(time.perf_counter() - began)
print(json.dumps(times))
"""


def seconds(preparation: str, call: str) -> list[float]:
    """Seconds of the first and of the second call, in a new process."""
    variables = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    code = BODY.format(preparation=preparation, call=call)
    said = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True)
    if said.returncode != 0:
        raise RuntimeError(said.stderr)
    return json.loads(said.stdout.splitlines()[-1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="ROW", choices=ROWS)
    print(f"{'seconds':36}{'first call':>12}{'second call':>13}")
    for row in parser.parse_args().only or ROWS:
        first, second = seconds(*ROWS[row])
        print(f"{row:36}{first:12.1f}{second:13.3f}", flush=True)


if __name__ == "__main__":
    main()
