"""Polytope of every interval, and node of every gate."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Flag, Points, Vector3
from jaxscp.corridor.polytopes import Corridor

LANDING = 5  # intervals, the last ones, that lie in the landing cone
IN_LAST = (
    LANDING + 1
)  # intervals in the last polytope: one leads to the cone, which other polytopes may not reach


def allocate(corridor: Corridor, start: Vector3, goal: Vector3, nodes: int) -> Int[Array, "intervals"]:
    """Polytope of every interval, by the lengths of the route from start over the joints to the goal.

    Every polytope gets one interval at least, and the last one as many as a landing needs, if there are enough. The
    time dilation adapts the mesh afterwards (Remark 1 of the paper).
    """
    route = jnp.concatenate([start[None], corridor.joints, goal[None]])
    length = jnp.cumsum(jnp.linalg.norm(jnp.diff(route, axis=0), axis=1))
    spare = nodes - 1 - corridor.count
    fraction = length[:-1] / jnp.maximum(length[-1], 1e-9)
    least = jnp.arange(1, corridor.count)
    ends = least + jnp.round(spare * fraction).astype(int)
    ends = jnp.maximum(jnp.minimum(ends, nodes - 1 - IN_LAST - least[::-1] + 1), least)
    return jnp.searchsorted(ends, jnp.arange(nodes - 1), side="right", method="compare_all").astype(int)


def fits(allocation: Int[Array, "intervals"], fresh: Int[Array, "intervals"]) -> Flag:
    """Whether an allocation of another corridor may serve again, in place of a fresh one.

    It does if it takes the polytopes in order, from the first to the last. Each must have half of the fresh one's
    intervals at least. Else the corridor is another one.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.landing.allocation import fits
        >>> two, three = jnp.array([0, 0, 1, 1, 1]), jnp.array([0, 1, 1, 2, 2])
        >>> bool(fits(two, jnp.array([0, 1, 1, 1, 1]))), bool(fits(two, three)), bool(fits(three, two))
        (True, False, False)
    """
    steps = jnp.diff(allocation)
    in_order = (allocation[0] == 0) & (allocation[-1] == fresh[-1]) & jnp.all((steps == 0) | (steps == 1))
    number = lambda of: jnp.sum(of[:, None] == fresh[None], axis=0)  # noqa: E731
    return in_order & jnp.all(2 * number(allocation) >= number(fresh))


def route_positions(
    corridor: Corridor, start: Vector3, goal: Vector3, allocation: Int[Array, "intervals"]
) -> Points:
    """Positions of the nodes on the polyline start, joints, goal; the nodes of a polytope evenly spaced on it."""
    route = jnp.concatenate([start[None], corridor.joints, goal[None]])
    intervals = jnp.arange(allocation.shape[0])
    first = jnp.searchsorted(allocation, allocation, side="left", method="compare_all").astype(int)
    last = jnp.searchsorted(allocation, allocation, side="right", method="compare_all").astype(int)
    fraction = (intervals - first) / (last - first)
    points = route[allocation] + fraction[:, None] * (route[allocation + 1] - route[allocation])
    return jnp.concatenate([points, goal[None]])


def gate_nodes(positions: Points, centres: Float[Array, "gates 3"]) -> Int[Array, "gates"]:
    """Node of every gate: the nearest on the route, after the node of the gate before and before the end."""
    count, nodes = centres.shape[0], positions.shape[0]
    index = jnp.arange(nodes)

    def next_gate(last, gate):
        number, centre = gate
        distance = jnp.linalg.norm(positions - centre, axis=1)
        open_ = (index > last) & (index < nodes - (count - number))  # leaves nodes for the next gates
        distance: Array = jnp.where(open_, distance, jnp.inf)
        node = jnp.argmin(distance)
        return node, node

    _, chosen = jax.lax.scan(next_gate, jnp.zeros((), int), (jnp.arange(count), centres))
    return chosen
