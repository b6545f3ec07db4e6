"""Time of whole plans by instruction set: libraries compiled for each level that runs here, and XLA alone.

This shows the speed to expect on a machine with fewer instructions. The levels take turns.
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
CALLS = 5  # calls in a turn


def run(echo: Callable[[str], None], nodes: int, repeats: int) -> dict[str, Any]:
    """Times of both modes on Case 1."""
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
    """Median of warm calls by level, ms."""
    with ExitStack() as processes:
        apart = [Apart(planned, level, mode, nodes, calls=CALLS) for level in levels]
        seconds = in_turns([processes.enter_context(each) for each in apart], repeats)
    return {level: 1e3 * float(np.median(calls)) for level, calls in zip(levels, seconds, strict=True)}


def planned(level: str, mode: str, nodes: int) -> Callable[[], float]:
    """A function: seconds of a plan. For a separate process, in which only this level exists."""
    libraries.LEVELS = (level,)
    planner, scenario = Planner(nodes=nodes, method=METHODS[mode]()), scenarios.platform_to_platform()
    return lambda: elapsed(lambda: planner(scenario))
