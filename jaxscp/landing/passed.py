"""The rest of a mission: after a part of the route, with the same shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core.types import Scalar
from jaxscp.landing.mission import Mission
from jaxscp.landing.places import Places, gates_behind, polytope_of
from jaxscp.landing.recovery import wall_excess

LEAST_TIME = 0.05  # of the rest of a plan: a rest may be quicker than the least time of the whole
PASSED_GATE = 1e-3  # times a passed gate's shape, a thousand times its size: it asks for nothing any more


def present_place(mission: Mission, places: Places, interval: Int[Array, ""] | int) -> Int[Array, ""]:
    """The place of the start: the planned one, if its polytope holds the start, or else the nearest one that does.

    A vehicle may be early or late. Noise, and the walls that move out for a start outside, may lead it into the next
    polytope. No gate is left out or flown again: those behind are the planned ones.

    Args:
        mission: its start is the present state.
        places: of every interval of the plan.
        interval: planned one.

    Example:
        >>> import dataclasses, jax, jax.numpy as jnp, jaxscp
        >>> from jaxscp.corridor import box, connect
        >>> jax.config.update("jax_enable_x64", True)
        >>> rooms = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])])
        >>> mission = jaxscp.scenarios.through(rooms, jaxscp.at_rest([1.0, 1.0, 1.0]), jaxscp.at_rest([8.0, 1.0, 1.0]))
        >>> for x in (4.5, 5.1):
        ...     here = dataclasses.replace(mission, start=jaxscp.at_rest([x, 1.0, 1.0]))
        ...     print(present_place(here, jnp.array([0, 0, 1, 1]), 1))
        0
        1
    """
    frozen = jax.lax.stop_gradient(mission.with_unit_directions())
    holds = (wall_excess(frozen, polytope_of(places)) == 0.0) & (
        gates_behind(places) == gates_behind(places[interval])
    )
    count = places.shape[0]
    distance = jnp.where(holds, jnp.abs(jnp.arange(count) - interval), count)
    return places[jnp.where(jnp.any(holds), jnp.argmin(distance), interval)]


def without_passed(mission: Mission, place: Int[Array, ""] | int, time: Scalar | float = jnp.inf) -> Mission:
    """The mission from a place of its route on; what lies before it asks for nothing any more.

    Shapes stay, so that no program compiles again: the polytope of the place stands instead of those before it. Their
    joints lie at the start, so that their legs have no length; so do passed gates, so wide that every way passes them.

    Args:
        mission: its start is the present state.
        place: of the start; zero changes nothing.
        time: s that the rest of a plan takes: much less is allowed.

    Example:
        >>> import jax, jaxscp
        >>> jax.config.update("jax_enable_x64", True)
        >>> rest = without_passed(jaxscp.scenarios.platform_to_platform(), 2)
        >>> [bool((rest.corridor.offsets[k] == rest.corridor.offsets[2]).all()) for k in range(4)]
        [True, True, True, False]
    """
    place = jnp.asarray(place)
    corridor, here, polytope = mission.corridor, mission.start.position, polytope_of(place)
    index = jnp.maximum(jnp.arange(corridor.count), polytope)
    behind = jnp.arange(corridor.joints.shape[0]) < polytope
    mission = eqx.tree_at(
        lambda m: (m.corridor.normals, m.corridor.offsets, m.corridor.joints, m.dilation_min),
        mission,
        (
            corridor.normals[index],
            corridor.offsets[index],
            jnp.where(behind[:, None], here, corridor.joints),
            jnp.minimum(mission.dilation_min, LEAST_TIME * time),
        ),
    )
    if mission.gates is None or mission.gates.centres.shape[0] == 0:
        return mission
    gates = mission.gates
    passed = jnp.arange(gates.centres.shape[0]) < gates_behind(place)
    return eqx.tree_at(
        lambda m: (m.gates.centres, m.gates.shapes),
        mission,
        (
            jnp.where(passed[:, None], here, gates.centres),
            jnp.where(passed[:, None, None], PASSED_GATE * gates.shapes, gates.shapes),
        ),
    )
