"""The programs of a corridor, compiled while the map is judged and the route is searched."""

from collections.abc import Callable

import numpy as np

from jaxscp.core.threads import beside
from jaxscp.corridor.cells import cells_along
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.decompose import Decomposition
from jaxscp.corridor.pruning import without_redundant

_LARGE = 200_000
"""Points of a map that takes long to judge."""


def precompile(method: Decomposition, points: int) -> Callable[[], None]:
    """Compile in another thread what a large map needs; returns a function that waits for that.

    Args:
        method: how to make a polytope.
        points: of the map; for a small one, nothing is begun.
    """
    return beside(lambda: _use(method)).result if points > _LARGE else lambda: None


def _use(method: Decomposition) -> None:
    """Corridors in free space: the same programs, without points to cut away."""
    cells = cells_along(method, np.zeros((2, 2, 3)), PointCloud.of(np.empty((0, 3))), radius=0.25)
    without_redundant(cells.polytope, clearance=0.1)
