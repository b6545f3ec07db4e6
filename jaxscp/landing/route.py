"""The route of a mission: from start to goal over the corridor's joints and the gates, in straight legs.

The joints and the gates have an order each. Of all ways to merge the two orders, the route is the shortest one whose
gates lie in the polytopes that they are passed in.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Points, Scalar, Vector3
from jaxscp.corridor.polytopes import Corridor

OUTSIDE = 1e3  # cost of a gate outside a polytope, in lengths of its distance


class Route(eqx.Module):
    """Way-points, and the legs between them."""

    points: Points
    """Start, joints and gates as they are passed, and goal, m."""
    polytope: Int[Array, "legs"]
    """Of every leg."""
    to_gate: Int[Array, "gates"]
    """Leg that ends at each gate."""
    padding: Int[Array, ""]
    """Number of legs at the end that only pad (``corridor.pad``)."""

    @property
    def lengths(self) -> Float[Array, "legs"]:
        """Of the legs, m."""
        return jnp.linalg.norm(jnp.diff(self.points, axis=0), axis=1)


def route_of(corridor: Corridor, start: Vector3, goal: Vector3, gates: Points | None = None) -> Route:
    """The route from start to goal.

    Args:
        corridor: with normals of length one.
        start: (3,) m.
        goal: (3,) m.
        gates: (gates, 3) centres in the order in which they are passed, m; None for none.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> jax.config.update("jax_enable_x64", True)
        >>> from jaxscp.corridor import box, connect
        >>> rooms = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])])
        >>> ends = jnp.array([1.0, 1.0, 1.0]), jnp.array([8.0, 1.0, 1.0])
        >>> route = route_of(rooms, *ends, jnp.array([[2.0, 1.5, 1.0], [7.0, 0.5, 1.0]]))
        >>> route.points[:, 0].tolist(), route.polytope.tolist(), route.to_gate.tolist()
        ([1.0, 2.0, 4.5, 7.0, 8.0], [0, 0, 1, 1], [0, 2])
    """
    if gates is None or gates.shape[0] == 0:
        points = jnp.concatenate([start[None], corridor.joints, goal[None]])
        polytope = jnp.arange(corridor.count)
        return Route(points, polytope, jnp.zeros(0, int), _padding(corridor, points, polytope))
    count, joints = gates.shape[0], corridor.joints.shape[0]
    within = _polytopes_of(corridor, start, goal, gates)
    # Joint j lies between polytopes j and j + 1; the gates of polytope j come before it, in their order.
    place = 2 * (count + 1) * within + jnp.arange(1, count + 1)
    order = jnp.argsort(jnp.concatenate([2 * (count + 1) * jnp.arange(joints) + count + 1, place]))
    inner = jnp.concatenate([corridor.joints, gates])[order]
    points = jnp.concatenate([start[None], inner, goal[None]])
    passed = jnp.concatenate([jnp.zeros(1, int), jnp.cumsum(order < joints)])
    return Route(points, passed, jnp.argsort(order)[joints:], _padding(corridor, points, passed))


def _padding(corridor: Corridor, points: Points, polytope: Int[Array, "legs"]) -> Int[Array, ""]:
    """Number of last legs without length in the polytope of the leg before: the goal lies before them."""
    again = corridor.same(polytope[1:], polytope[:-1])
    idle = again & jnp.all(points[1:-1] == points[2:], axis=1)
    return jnp.sum(jnp.cumprod(idle[::-1].astype(int)))


def _polytopes_of(corridor: Corridor, start: Vector3, goal: Vector3, gates: Points) -> Int[Array, "gates"]:
    """Polytope of each gate, none before an earlier gate's: the shortest way, by dynamic programming."""
    heights = jnp.einsum("kfc,gc->gkf", corridor.normals, gates) - corridor.offsets[None]
    outside = jnp.maximum(jnp.max(heights, axis=-1), 0.0)

    def forward(carry, gate):
        before, lengths = carry
        centre, penalty = gate
        total = lengths[:, None] + _way_lengths(corridor.joints, before, centre)
        return (centre, jnp.min(total, axis=0) + OUTSIDE * penalty), jnp.argmin(total, axis=0)

    index = jnp.arange(corridor.count)
    first = jnp.where(index == 0, 0.0, jnp.inf)
    (last, lengths), came_from = jax.lax.scan(forward, (start, first), (gates, outside))
    final = jnp.argmin(lengths + _way_lengths(corridor.joints, last, goal)[:, -1])
    # Row g of ``came_from`` leads from gate g to the gate before, and row 0 to the start.
    _, before = jax.lax.scan(lambda p, table: (table[p], p), final, came_from, reverse=True)
    return before


def _way_lengths(joints: Points, first: Vector3, last: Vector3) -> Float[Array, "polytopes polytopes"]:
    """Length of the way from a point in polytope i over the joints to a point in polytope j; infinite for j < i."""
    count = joints.shape[0] + 1
    i, j = jnp.arange(count)[:, None], jnp.arange(count)[None]
    if count == 1:
        return jnp.linalg.norm(last - first)[None, None]
    along = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.linalg.norm(jnp.diff(joints, axis=0), axis=1))])
    leave = jnp.minimum(i, count - 2)  # joint after polytope i
    arrive = jnp.maximum(j - 1, 0)  # joint before polytope j
    to_first = jnp.linalg.norm(joints - first[None], axis=1)[leave]
    to_last = jnp.linalg.norm(joints - last[None], axis=1)[arrive]
    over_joints: Array = to_first + along[arrive] - along[leave] + to_last
    direct: Scalar = jnp.linalg.norm(last - first)
    return jnp.where(i == j, direct, jnp.where(i < j, over_joints, jnp.inf))
