"""Whole plans by what was compiled for each level of the instruction set that runs here, and by XLA alone, in turns:
what to expect of a machine with less.
"""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from benchmarks.speed.apart import Apart, in_turns
from benchmarks.speed.timing import elapsed
from jaxscp import PTR, NewtonSCP, Planner, scenarios
from jaxscp.backends import libraries
from jaxscp.conic import native

METHODS = {"paper": PTR, "default": NewtonSCP}
INSTRUCTIONS = {"v4": "AVX-512", "v3": "AVX2", "any": "baseline", "none": "XLA alone"}
CALLS = 5  # of a turn


def run(echo: Callable[[str], None], nodes: int, repeats: int) -> dict[str, Any]:
    """Both modes on Case 1."""
    levels = [
        level for level in libraries.LEVELS if libraries.library(native.LIBRARY.stem, level) is not None
    ]
    levels.append("none")
    rows = {mode: milliseconds(mode, levels, nodes, repeats) for mode in METHODS}
    echo(f"{'a plan, ms':16}" + "".join(f"{mode:>10}" for mode in METHODS))
    for level in levels:
        echo(f"{INSTRUCTIONS[level]:16}" + "".join(f"{rows[mode][level]:10.1f}" for mode in METHODS))
    return {"levels": rows}


def milliseconds(mode: str, levels: list[str], nodes: int, repeats: int) -> dict[str, float]:
    """Median of warm calls by level."""
    with ExitStack() as processes:
        apart = [Apart(planned, level, mode, nodes, calls=CALLS) for level in levels]
        seconds = in_turns([processes.enter_context(each) for each in apart], repeats)
    return {level: 1e3 * float(np.median(calls)) for level, calls in zip(levels, seconds, strict=True)}


def planned(level: str, mode: str, nodes: int) -> Callable[[], float]:
    """In a process of its own, which knows no other level: seconds of a plan."""
    libraries.LEVELS = (level,)
    planner, scenario = Planner(nodes=nodes, method=METHODS[mode]()), scenarios.platform_to_platform()
    return lambda: elapsed(lambda: planner(scenario))
