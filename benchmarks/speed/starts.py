"""From ``python -c`` to the first answer, in fresh processes: with an empty compilation cache, and with a full one.

``cold`` fills the cache that ``cached`` finds. The cache is jax's own, switched on by its environment variables.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

METHODS = {"paper": "jaxscp.SCP()", "default": "jaxscp.NewtonSCP()"}
FIRST = "default"  # whose times are the benchmark's
PLAN = """
import jax
jax.config.update("jax_enable_x64", True)
import jaxscp
solution = jaxscp.Planner(nodes={nodes}, method={method})(jaxscp.scenarios.platform_to_platform())
assert jaxscp.status_names(solution.status) == "converged"
"""


def run(echo: Callable[[str], None], nodes: int) -> dict[str, Any]:
    """Both modes on Case 1."""
    echo(f"{'start, s':12}{'cold':>8}{'cached':>8}")
    rows = {}
    for mode, method in METHODS.items():
        with tempfile.TemporaryDirectory() as cache:
            code = PLAN.format(nodes=nodes, method=method)
            rows[mode] = {"cold_s": seconds(code, cache), "cached_s": seconds(code, cache)}
        echo(f"{mode:12}{rows[mode]['cold_s']:8.1f}{rows[mode]['cached_s']:8.1f}")
    return {
        "starts_mode": FIRST,
        "cold_start_s": rows[FIRST]["cold_s"],
        "cached_start_s": rows[FIRST]["cached_s"],
        "starts": rows,
    }


def seconds(code: str, cache: str) -> float:
    """Of a process that runs the code with a compilation cache."""
    variables = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", code], check=True, env=os.environ | variables, stderr=subprocess.PIPE
    )
    return time.perf_counter() - began
