"""Recovery: a start that lies a little outside of a wall, a zone or a limit, as a measured one may.

What the start breaks is loosened by twice as much in the first interval, by less in each of the next ones, and then
holds. No other wall moves.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Flag, Scalar
from jaxscp.landing.mission import Ellipsoids, FlightLimits, Mission

CLEARANCE = 1e-6  # m by which start and goal may miss their polytope, for rounding
RECOVERY = 0.1  # m by which the start of a re-plan may lie outside
LIMIT_RECOVERY = 0.1  # fraction by which a start that may lie outside may exceed a limit
ROOM = 2.0  # times what the start breaks: a start that touches a wall is hard to leave from
INTERVALS = 4  # in which the vehicle comes back
BRAKING = 0.1  # times gravity: what a vehicle that flies outwards has to brake with
ROUNDING = 1e-9  # times a limit, or a zone's size, that counts as none


def fading(nodes: int) -> Float[Array, "nodes"]:
    """Relief at each node, times what the start breaks: ``ROOM`` at the first, zero from ``INTERVALS`` on."""
    return ROOM * jnp.maximum(1.0 - jnp.arange(nodes) / INTERVALS, 0.0)


def wall_relief(mission: Mission, polytope: Int[Array, "nodes"]) -> Float[Array, "nodes faces"]:
    """Distances in m by which the walls of each node's polytope move out; zero for a start inside its own polytope.

    Args:
        mission: with unit normals.
        polytope: of every node.
    """
    corridor, start = mission.corridor, mission.start
    beyond = corridor.normals @ start.position - corridor.offsets
    worst = jnp.where(_starts_anywhere(mission), 0.0, jnp.max(beyond[polytope[0]]))
    outwards = jnp.maximum(corridor.normals @ start.velocity, 0.0)
    way = outwards**2 / (2.0 * BRAKING * jnp.linalg.norm(mission.airframe.body.gravity))
    # Other polytopes, which the vehicle has not reached, open no further than its own.
    relief = jnp.where((beyond > 0.0) & (worst > CLEARANCE), jnp.minimum(beyond, worst) + way / ROOM, 0.0)
    return relief[polytope] * fading(polytope.shape[0])[:, None]


def limits_at_nodes(mission: Mission, nodes: int) -> FlightLimits:
    """Limits of speed, tilt and body rate at every node, (nodes,) each: those that the start exceeds fall to the limit.

    The thrust rate stays one number.
    """
    limits = mission.limits

    def at_nodes(name: str, size: Scalar) -> Any:
        limit = getattr(limits, name)
        if limit is None:
            return None
        excess = jnp.where(_starts_anywhere(mission), 0.0, jnp.maximum(size - limit, 0.0))
        return limit + jnp.where(excess > ROUNDING * limit, excess, 0.0) * fading(nodes)

    found = {name: at_nodes(name, size) for name, size in _sizes(mission).items()}
    return dataclasses.replace(limits, **found)


def zones_at_nodes(
    mission: Mission, zones: Ellipsoids, nodes: int
) -> tuple[Float[Array, "nodes zones 3"], Float[Array, "nodes zones 3 3"]]:
    """Centres and shapes of keep-out zones at every node: a zone around the start begins smaller, and grows again."""
    depth = jnp.where(_starts_anywhere(mission), 0.0, 1.0 - jnp.minimum(_nearness(mission, zones), 1.0))
    size = 1.0 - depth * fading(nodes)[:, None]
    return jnp.broadcast_to(zones.centres, (nodes, *zones.centres.shape)), zones.shapes / size[
        ..., None, None
    ]


def starts_outside(mission: Mission) -> Flag:
    """Whether the start lies outside of its polytope, inside of a zone or beyond a limit.

    Args:
        mission: with unit directions.
    """
    corridor = mission.corridor
    beyond = jnp.max(corridor.normals[0] @ mission.start.position - corridor.offsets[0])
    found = [beyond > CLEARANCE]
    for name, size in _sizes(mission).items():
        if (limit := getattr(mission.limits, name)) is not None:
            found.append(size > (1.0 + ROUNDING) * limit)
    if mission.keep_out is not None:
        found.append(jnp.any(_nearness(mission, mission.keep_out) < 1.0 - ROUNDING))
    return jnp.any(jnp.stack(found)) & ~jnp.asarray(_starts_anywhere(mission))


def _starts_anywhere(mission: Mission) -> bool:
    """Whether components of the start are free: then it is no measured state."""
    return mission.start_fixed is not None


def _sizes(mission: Mission) -> dict[str, Scalar]:
    """Of the start, in the units of the limits."""
    start = mission.start
    tilt = 2.0 * jnp.arcsin(jnp.minimum(jnp.sqrt(_sum_of_squares(start.attitude[1:3])), 1.0))
    return {
        "speed": jnp.sqrt(_sum_of_squares(start.velocity)),
        "tilt": tilt,
        "body_rate": jnp.sqrt(_sum_of_squares(start.body_rate)),
    }


def _sum_of_squares(vector: Float[Array, "_"]) -> Scalar:
    """Its root has a derivative at zero."""
    return jnp.maximum(jnp.sum(vector**2), jnp.finfo(vector.dtype).tiny)


def _nearness(mission: Mission, zones: Ellipsoids) -> Float[Array, "zones"]:
    """|shape (p - centre)| of the start: below one inside of a zone."""
    away = jnp.einsum("zrc,zc->zr", zones.shapes, mission.start.position - zones.centres)
    return jnp.sqrt(jnp.maximum(jnp.sum(away**2, axis=1), jnp.finfo(away.dtype).tiny))
