"""Recovery: a start that lies a little outside of a wall, a zone or a limit, as a measured one may.

A wall that the start breaks moves out in the first interval, by twice as much. In each of the next intervals it comes
back by a part, and then it holds. Zones and limits do the same. Nothing else changes.
"""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Flag, Scalar
from jaxscp.landing.mission import Ellipsoids, FlightLimits, Mission

CLEARANCE = 1e-6  # m by which start and goal may miss their polytope, for rounding
RECOVERY = 0.1  # m by which the start of a re-plan may lie outside
LIMIT_RECOVERY = 0.1  # fraction by which a start that may lie outside may exceed a limit
ROOM = 2.0  # first relief over what the start breaks: it is hard to leave from a wall that one touches
INTERVALS = 4  # in which the vehicle comes back
BRAKING = 0.1  # times gravity: deceleration of a vehicle that flies outwards
FARTHEST = 0.1  # m that it may go further out, however fast: behind a wall may be another one
ROUNDING = 1e-9  # times a limit, or a zone's size, that counts as none


def fading(nodes: int) -> Float[Array, "nodes"]:
    """Relief at each node over what the start breaks: ``ROOM`` at the first, zero from ``INTERVALS`` on."""
    return ROOM * jnp.maximum(1.0 - jnp.arange(nodes) / INTERVALS, 0.0)


def wall_relief(mission: Mission, polytope: Int[Array, "nodes"]) -> Float[Array, "nodes faces"]:
    """Distances in m by which the walls of each node's polytope move out; zero for a start inside its own polytope.

    Args:
        mission: with unit normals.
        polytope: of every node.
    """
    corridor, start = mission.corridor, mission.start
    excess = wall_excess(mission, polytope[0])
    beyond = corridor.normals @ start.position - corridor.offsets
    outwards = jnp.maximum(corridor.normals @ start.velocity, 0.0)
    way = outwards**2 / (2.0 * BRAKING * jnp.linalg.norm(mission.airframe.body.gravity))
    way = jnp.minimum(way, FARTHEST)
    # Other polytopes, which the vehicle has not reached, open no further than its own.
    relief = jnp.where((beyond > 0.0) & (excess > 0.0), jnp.minimum(beyond, excess) + way / ROOM, 0.0)
    return relief[polytope] * fading(polytope.shape[0])[:, None]


def limits_at_nodes(mission: Mission, nodes: int) -> FlightLimits:
    """Limits of speed, tilt and body rate at every node, (nodes,) each: those that the start exceeds fall to the limit.

    The thrust rate stays one number.
    """
    excess = _limit_excess(mission)
    found = {name: getattr(mission.limits, name) + by * fading(nodes) for name, by in excess.items()}
    return dataclasses.replace(mission.limits, **found)


def zones_at_nodes(
    mission: Mission, zones: Ellipsoids, nodes: int
) -> tuple[Float[Array, "nodes zones 3"], Float[Array, "nodes zones 3 3"]]:
    """Centres and shapes of keep-out zones at every node: a zone around the start begins smaller, and grows again."""
    size = 1.0 - _zone_excess(mission, zones) * fading(nodes)[:, None]
    centres = jnp.broadcast_to(zones.centres, (nodes, *zones.centres.shape))
    return centres, zones.shapes / size[..., None, None]


def starts_outside(mission: Mission) -> Flag:
    """Whether the start lies outside of its polytope, inside of a zone or beyond a limit.

    Args:
        mission: with unit directions.
    """
    excess = [wall_excess(mission, 0), *_limit_excess(mission).values()]
    if mission.keep_out is not None:
        excess.append(jnp.max(_zone_excess(mission, mission.keep_out), initial=0.0))
    return jnp.any(jnp.stack(excess) > 0.0)


# A start with free components is no measured state: it breaks nothing.


def wall_excess(mission: Mission, polytope: Int[Array, "*any"] | int) -> Float[Array, "*any"]:
    """Distance in m by which the start lies outside of each given polytope; for a mission with unit normals."""
    if mission.start_fixed is not None:
        return jnp.zeros(jnp.shape(polytope), mission.start.position.dtype)
    corridor = mission.corridor
    heights = corridor.normals[polytope] @ mission.start.position - corridor.offsets[polytope]
    beyond = jnp.max(heights, axis=-1)
    return jnp.where(beyond > CLEARANCE, beyond, 0.0)


def _limit_excess(mission: Mission) -> dict[str, Scalar]:
    """What the start exceeds each limit by, in the limit's unit; only limits that there are."""
    start, limits = mission.start, mission.limits
    sizes = {
        "speed": _length(start.velocity),
        "tilt": 2.0 * jnp.arcsin(jnp.minimum(_length(start.attitude[1:3]), 1.0)),
        "body_rate": _length(start.body_rate),
    }
    given: dict[str, Scalar] = {name: limit for name in sizes if (limit := getattr(limits, name)) is not None}
    if mission.start_fixed is not None:
        return {name: jnp.zeros_like(limit) for name, limit in given.items()}
    beyond = {name: sizes[name] - limit for name, limit in given.items()}
    return {name: jnp.where(by > ROUNDING * given[name], by, 0.0) for name, by in beyond.items()}


def _zone_excess(mission: Mission, zones: Ellipsoids) -> Float[Array, "zones"]:
    """Depth of the start in each zone, over the zone's size."""
    if mission.start_fixed is not None:
        return jnp.zeros_like(zones.centres[:, 0])
    away = jnp.einsum("zrc,zc->zr", zones.shapes, mission.start.position - zones.centres)
    depth = 1.0 - jnp.sqrt(jnp.maximum(jnp.sum(away**2, axis=1), jnp.finfo(away.dtype).tiny))
    return jnp.where(depth > ROUNDING, depth, 0.0)


def _length(vector: Float[Array, "_"]) -> Scalar:
    """With a derivative at zero."""
    return jnp.sqrt(jnp.maximum(jnp.sum(vector**2), jnp.finfo(vector.dtype).tiny))
