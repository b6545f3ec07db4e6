"""Time from ``python -c`` to the first plan in a fresh process: empty cache, full cache, exported planner.

``cold`` fills the cache that ``cached`` reads: the folder of ``jaxscp.use_cache``.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

METHODS = {"paper": "jaxscp.PTR()", "default": "jaxscp.NewtonSCP()"}
FIRST = "default"  # the mode of the reported times
IMPORT = """
import jax
jax.config.update("jax_enable_x64", True)
import jaxscp
"""
SCENARIO = "scenario = jaxscp.scenarios.platform_to_platform()\n"
CACHE = "jaxscp.use_cache({folder!r})\n"
PLANNER = "planner = jaxscp.Planner(nodes={nodes}, method={method})\n"
LOAD = "planner = jaxscp.load({file!r})\n"
EXPORT = SCENARIO + "planner.export({file!r}, scenario)\nprint('converged')\n"
PLAN = SCENARIO + "print(jaxscp.status_names(planner(scenario).status), flush=True)\n"
ANSWER = "converged"
KINDS = ("cold", "cached", "export")


def run(echo: Callable[[str], None], nodes: int) -> dict[str, Any]:
    """Times of both modes on Case 1."""
    echo(f"{'start, s':12}" + "".join(f"{kind:>8}" for kind in KINDS))
    rows = {}
    for mode, method in METHODS.items():
        rows[mode] = starts(method, nodes)
        echo(f"{mode:12}" + "".join(f"{rows[mode][kind]:8.1f}" for kind in KINDS))
    return {
        "starts_mode": FIRST,
        "starts": rows,
        **{f"{kind}_start_s": rows[FIRST][kind] for kind in KINDS},
    }


def starts(method: str, nodes: int) -> dict[str, float]:
    """Seconds of a start, by kind."""
    planner = PLANNER.format(nodes=nodes, method=method)
    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "planner.jaxscp")
        keeping = IMPORT + CACHE.format(folder=folder) + planner + PLAN
        cold, cached = (seconds(keeping) for _ in range(2))
        seconds(IMPORT + planner + EXPORT.format(file=file))
        return {"cold": cold, "cached": cached, "export": seconds(IMPORT + LOAD.format(file=file) + PLAN)}


def seconds(code: str) -> float:
    """Seconds from the start of a process that runs the code to its first printed line."""
    variables = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    began = time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-c", code], env=variables, stdout=subprocess.PIPE, stderr=said, text=True
        )
        with process:
            answer = process.stdout.readline().strip() if process.stdout else ""
            took = time.perf_counter() - began
        said.seek(0)
        if process.returncode != 0 or answer != ANSWER:
            raise RuntimeError(f"no plan, but {answer!r}: {said.read()}")
    return took
