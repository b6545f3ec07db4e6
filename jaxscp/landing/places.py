"""Places: in which polytope each interval of a plan lies, and how many gates lie behind it.

A leg's number depends on the order of joints and gates, and a new start may change the order. A place stays what it is,
so plans keep places. Without gates, both are the number of the polytope.
"""

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core.types import Flag
from jaxscp.corridor.polytopes import Corridor
from jaxscp.landing.route import Route

GATE = 2**16  # a place is the polytope's number, plus so much for each gate behind it

Places = Int[Array, "intervals"]


def places_on(route: Route, allocation: Int[Array, "intervals"]) -> Places:
    """Place of each interval.

    Args:
        route: with its legs.
        allocation: leg of every interval.

    Example:
        >>> import jax, jaxscp
        >>> from jaxscp.landing.allocation import allocate
        >>> jax.config.update("jax_enable_x64", True)
        >>> route = jaxscp.scenarios.ascent_to_platform().route()
        >>> bool((places_on(route, allocate(route, 30)) == allocate(route, 30)).all())
        True
    """
    passed = jnp.sum(route.to_gate[None] < allocation[:, None], axis=1)
    return route.polytope[allocation] + GATE * passed


def polytope_of(place: Int[Array, "*any"]) -> Int[Array, "*any"]:
    """The polytope's number."""
    return place % GATE


def gates_behind(place: Int[Array, "*any"]) -> Int[Array, "*any"]:
    """Number of gates passed before."""
    return place // GATE


def leg_of(place: Int[Array, "*any"]) -> Int[Array, "*any"]:
    """The leg's number: every leg but the first begins at a joint or at a gate."""
    return polytope_of(place) + gates_behind(place)


def ends_route(place: Int[Array, ""], corridor: Corridor, gates: int) -> Flag:
    """Whether a route may end at a place: behind all gates, in the last polytope or in one that padding repeats."""
    last = corridor.count - 1
    polytope = jnp.minimum(polytope_of(place), last)
    inside = (polytope_of(place) <= last) & corridor.same(polytope, jnp.asarray(last))
    return inside & (gates_behind(place) == gates)


def fits(places: Places, fresh: Places) -> Flag:
    """Whether the places of an earlier plan may serve again, instead of fresh ones.

    They do if they follow each other in the same order, from the first to the last. Each after the first must have a
    quarter of the fresh one's intervals at least. Else the route is another one. Of the first leg, little may be left.

    Example:
        >>> import jax.numpy as jnp
        >>> two, three = jnp.array([0, 0, 1, 1, 1]), jnp.array([0, 1, 1, 2, 2])
        >>> bool(fits(two, jnp.array([0, 1, 1, 1, 1]))), bool(fits(two, three)), bool(fits(three, two))
        (True, False, False)
    """
    known = jnp.any(places[:, None] == fresh[None], axis=1)
    in_order = jnp.all(jnp.diff(places) >= 0) & jnp.all(known)
    ends = (places[0] == fresh[0]) & (places[-1] == fresh[-1])
    number = lambda of: jnp.sum(of[:, None] == fresh[None], axis=0)  # noqa: E731
    return in_order & ends & jnp.all((fresh == fresh[0]) | (4 * number(places) >= number(fresh)))
