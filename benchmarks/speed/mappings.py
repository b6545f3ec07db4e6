"""Memory mappings of one process with many compiled planners of batches, each of another number of nodes."""

from collections.abc import Callable
from typing import Any

import jax

from jaxscp import Planner
from jaxscp.aot.mappings import count, limit
from jaxscp.landing.scenarios import ascent_to_platform

PLANNERS = 40
LEAST_NODES = 8
BATCH = 4


def run(echo: Callable[[str], None], planners: int = PLANNERS) -> dict[str, Any]:
    """Compile so many planners and hold them all; each plans a batch once."""
    scenario = ascent_to_platform()
    batch = jax.tree.map(lambda v: jax.numpy.stack([v] * BATCH), scenario)
    held, found = [], []
    for nodes in range(LEAST_NODES, LEAST_NODES + planners):
        held.append(Planner(nodes=nodes).compile(scenario, BATCH))
        jax.block_until_ready(held[-1](batch))
        found.append(count())
        echo(f"{len(held)} planners of batches: {found[-1]} mappings, {limit()} allowed")
    return {"planners": planners, "mappings": found, "mappings_allowed": limit()}
