"""The rest of a mission: after a part of the route, with the same shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core.types import Scalar
from jaxscp.landing.mission import Mission
from jaxscp.landing.recovery import CLEARANCE

LEAST_TIME = 0.05  # of the rest of a plan: a rest may be quicker than the least time of the whole
PASSED_GATE = 1e-3  # times a passed gate's shape, a thousand times its size: it asks for nothing any more


def present_leg(mission: Mission, leg: Int[Array, ""] | int) -> Int[Array, ""]:
    """The leg that the start lies on: the planned one, or a later one that it has reached.

    Noise, and the walls that move out for a start outside, lead a vehicle out of its polytope and into the next one.

    Args:
        mission: its start is the present state.
        leg: planned one, of its route.

    Example:
        >>> import dataclasses, jax, jaxscp
        >>> from jaxscp.corridor import box, connect
        >>> jax.config.update("jax_enable_x64", True)
        >>> rooms = connect([box([0, 0, 0], [5, 2, 2]), box([4, 0, 0], [9, 2, 2])])
        >>> ends = jaxscp.at_rest([1.0, 1.0, 1.0]), jaxscp.at_rest([8.0, 1.0, 1.0])
        >>> for x in (4.5, 5.1):
        ...     start = jaxscp.at_rest([x, 1.0, 1.0])
        ...     mission = dataclasses.replace(jaxscp.scenarios.through(rooms, *ends), start=start)
        ...     print(present_leg(mission, 0))
        0
        1
    """
    frozen = jax.lax.stop_gradient(mission.with_unit_directions())
    inside = frozen.corridor.clearance(frozen.start.position)[frozen.route().polytope]
    left = (inside[:-1] < -CLEARANCE) & (inside[1:] > inside[:-1])
    behind = left | (jnp.arange(left.shape[0]) < leg)
    return jnp.sum(jnp.cumprod(behind.astype(int)))


def without_passed(mission: Mission, leg: Int[Array, ""] | int, time: Scalar | float = jnp.inf) -> Mission:
    """The mission whose start lies on a leg of its route; what lies before the leg asks for nothing any more.

    Shapes stay, so that no program compiles again: the polytope of the leg stands in place of those before it. Their
    joints lie at the start, so that their legs have no length; so do passed gates, so wide that every way passes them.

    Args:
        mission: its start is the present state.
        leg: of its route; zero changes nothing.
        time: s that the rest of a plan takes: much less is allowed.

    Example:
        >>> import jax, jaxscp
        >>> jax.config.update("jax_enable_x64", True)
        >>> rest = without_passed(jaxscp.scenarios.platform_to_platform(), 2)
        >>> [bool((rest.corridor.offsets[k] == rest.corridor.offsets[2]).all()) for k in range(4)]
        [True, True, True, False]
    """
    frozen = jax.lax.stop_gradient(mission.with_unit_directions())
    route, corridor, here = frozen.route(), mission.corridor, mission.start.position
    polytope = route.polytope[leg]
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
    passed, gates = route.to_gate < leg, mission.gates
    return eqx.tree_at(
        lambda m: (m.gates.centres, m.gates.shapes),
        mission,
        (
            jnp.where(passed[:, None], here, gates.centres),
            jnp.where(passed[:, None, None], PASSED_GATE * gates.shapes, gates.shapes),
        ),
    )
