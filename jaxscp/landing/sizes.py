"""Sizes of a mission, taken from the mission itself: of a length, a time, a mass and a cost.

With these as units, gravity is 9.81, the mass is the mass of the paper's vehicle, and the route is eight long.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.landing.mission import Mission

# The solver's own tolerances and weights were tuned on problems of about these sizes.
ROUTE = 8.0  # length of a route
VEHICLE = 4.0  # radii of gyration that count as route, for routes of no length
GRAVITY = 9.81
MASS = 0.928
HOVER = 4.55  # norm of the thrusts that carry that mass, for four rotors
TYPICAL_TIME = 2.2  # of a flight


class MissionSizes(eqx.Module):
    """Sizes that the solver takes as its units."""

    length: Scalar
    """m"""
    time: Scalar
    """s"""
    mass: Scalar
    """kg"""
    cost: Scalar


def sizes_of(mission: Mission) -> MissionSizes:
    """Sizes of a mission, with derivatives; one where they are not finite and positive."""
    body, start, goal = mission.airframe.body, mission.start.position, mission.goal.position
    route = jnp.concatenate([start[None], mission.corridor.joints, goal[None]])
    gyration = VEHICLE**2 * jnp.trace(body.inertia) / body.mass
    length = jnp.sqrt(jnp.sum(_lengths(jnp.diff(route, axis=0))) ** 2 + gyration) / ROUTE
    gravity, hover = _lengths(body.gravity[None])[0], _lengths(body.hover_thrust()[None])[0]
    falls, weights = gravity > 0.0, mission.weights
    time = jnp.where(falls, jnp.sqrt(GRAVITY * length / jnp.where(falls, gravity, 1.0)), 1.0)
    cost = (weights.control * hover + weights.time) * time / HOVER
    one = jnp.ones((), start.dtype)
    sizes = length, time, body.mass / MASS, cost
    return MissionSizes(*(jnp.where(jnp.isfinite(v) & (v > 0.0), v, one) for v in sizes))


def _lengths(vectors: Float[Array, "vectors size"]) -> Float[Array, "vectors"]:
    """Lengths, with derivatives of zero at zero."""
    squares = jnp.sum(vectors**2, axis=1)
    some = squares > 0.0
    return jnp.where(some, jnp.sqrt(jnp.where(some, squares, 1.0)), 0.0)
