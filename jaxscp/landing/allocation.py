"""Leg of every interval: how the intervals are shared out over the legs of a route."""

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core.types import Points
from jaxscp.landing.route import Route

LANDING = 5  # intervals, the last ones, that lie in the landing cone
INTERVALS_A_LEG = 5
LADDER = (30, 45, 60, 90)  # usual numbers of nodes: few, so that scenarios of nearly one shape share programs
# Intervals of the last leg that lead to the cone, at least: up to ``LADDER[0]`` nodes, and beyond.
TO_CONE = 1, 4
# A leg's share grows with this power of its length. The turns at its ends need intervals, however short it is; with
# shares by length, narrow chains of seven or eight boxes end in ``dynamics_unmet``.
GROWTH = 0.25
ROUNDING = 1e-6  # of a number of intervals: equal legs share evenly


def allocate(route: Route, nodes: int) -> Int[Array, "intervals"]:
    """Leg of every interval: longer legs get more, but not in proportion.

    Every leg gets one interval at least, and the last one as many as a landing needs, if there are enough. The time
    dilation adapts the mesh afterwards (Remark 1 of the paper). Legs of length zero at the start lie behind the vehicle
    (``passed``), and get none; nor do legs at the end that only pad.
    """
    lengths, count = route.lengths, route.lengths.shape[0]
    share = jnp.cumsum(lengths**GROWTH)
    passed = jnp.sum(share[:-1] == 0.0)
    last = count - 1 - jnp.minimum(route.padding, count - 1 - passed)
    legs = last + 1 - passed
    spare = (nodes - 1 - legs).astype(share.dtype)  # beyond one for each leg
    # The last leg's share is taken from all legs before it, not from its neighbour alone.
    most = jnp.maximum(spare + 1.0 - in_last(nodes), 0.0)
    before = jnp.where(last > 0, share[last - 1], 0.0)
    before_last = jnp.minimum(spare * before / jnp.maximum(share[-1], 1e-9), most)
    fraction = share[:-1] / jnp.maximum(before, 1e-9)
    least = jnp.maximum(jnp.arange(1, count) - passed, 0)
    # Where intervals are few, earlier legs get the odd ones: the first one starts from rest.
    exact, few = before_last * fraction, nodes <= INTERVALS_A_LEG * legs
    ends = least + jnp.where(few, jnp.ceil(exact - ROUNDING), jnp.round(exact)).astype(int)
    ends = jnp.where(jnp.arange(count - 1) < last, ends, nodes - 1)
    return jnp.searchsorted(ends, jnp.arange(nodes - 1), side="right", method="compare_all").astype(int)


def in_last(nodes: int) -> int:
    """Intervals of the last leg, at least: it leads to the cone, which other polytopes may not reach.

    A longer flight arrives faster, and must turn and brake before the cone. One interval is then the longest of all,
    and too coarse.
    """
    return LANDING + TO_CONE[nodes > LADDER[0]]


def usual_nodes(legs: int) -> int:
    """Nodes for a route: enough for ``INTERVALS_A_LEG`` intervals a leg, 30 at least.

    With fewer, a turn between two legs lies within one interval, and many plans end in ``dynamics_unmet``.

    Example:
        >>> from jaxscp.landing.allocation import usual_nodes
        >>> [usual_nodes(legs) for legs in (1, 5, 8, 12, 40)]
        [30, 30, 45, 90, 201]
    """
    needed = INTERVALS_A_LEG * legs + 1
    return next((nodes for nodes in LADDER if nodes >= needed), needed)


def route_positions(route: Route, allocation: Int[Array, "intervals"]) -> Points:
    """Positions of the nodes on the route; the nodes of a leg are evenly spaced on it."""
    points, intervals = route.points, jnp.arange(allocation.shape[0])
    first = jnp.searchsorted(allocation, allocation, side="left", method="compare_all").astype(int)
    last = jnp.searchsorted(allocation, allocation, side="right", method="compare_all").astype(int)
    fraction = (intervals - first) / (last - first)
    positions = points[allocation] + fraction[:, None] * (points[allocation + 1] - points[allocation])
    return jnp.concatenate([positions, points[-1:]])


def gate_nodes(route: Route, allocation: Int[Array, "intervals"]) -> Int[Array, "gates"]:
    """Node of every gate: where the leg that leads to it ends."""
    return jnp.searchsorted(allocation, route.to_gate, side="right", method="compare_all").astype(int)
