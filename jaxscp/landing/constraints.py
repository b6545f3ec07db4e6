"""Constraint functions of a landing: corridor, cone, limits and zones (equations 20-23)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar

NUDGE = 1e-6  # m


class HalfSpaces(eqx.Module):
    """Parameters of ``inside_half_spaces``."""

    normals: Float[Array, "*nodes faces 3"]
    offsets: Float[Array, "*nodes faces"]


def inside_half_spaces(state, control, time, p: HalfSpaces) -> Float[Array, "faces"]:
    """Distances in m from the position to each face (equation 20): A_c p <= b_c."""
    return p.offsets - p.normals @ state[:3]


class LandingCone(eqx.Module):
    """Parameters of ``inside_landing_cone``."""

    apex: Float[Array, "*nodes 3"]
    """p_f: the landing point in m, at time zero."""
    velocity: Float[Array, "*nodes 3"]
    """Of the deck, m/s."""
    axes: Float[Array, "*nodes 3 3"]
    """Of the deck, as columns; the third is its normal."""
    cotangent: Float[Array, "*nodes"]
    """cot(gamma_c): gamma_c is the angle of the cone's side above the deck."""


def inside_landing_cone(state, control, time, p: LandingCone) -> Float[Array, "3"]:
    """Distance along the deck bounded by cot(gamma_c) times the height above it (equations 21-22)."""
    return _above_apex(state, p.apex, p)


def inside_moving_landing_cone(state, control, time, p: LandingCone) -> Float[Array, "3"]:
    """``inside_landing_cone`` of a deck that moves.

    The landing point is affine in time, so that the cone stays convex with time as a state.
    """
    return _above_apex(state, p.apex + p.velocity * time, p)


def _above_apex(state, apex: Float[Array, "3"], p: LandingCone) -> Float[Array, "3"]:
    offset = p.axes.T @ (state[:3] - apex)
    return jnp.concatenate([(p.cotangent * offset[2])[None], offset[:2]])


class Limits(eqx.Module):
    """Parameters of ``within_control_limits``."""

    lower: Float[Array, "*nodes controls"]
    upper: Float[Array, "*nodes controls"]


def within_control_limits(state, control, time, p: Limits) -> Float[Array, "rows"]:
    """u_min <= u <= u_max (equation 23)."""
    return jnp.concatenate([control - p.lower, p.upper - control])


def within_speed(state, control, time, limit: Scalar) -> Float[Array, "4"]:
    """|v| <= limit, in m/s."""
    return jnp.concatenate([limit[None], state[3:6]])


def within_body_rate(state, control, time, limit: Scalar) -> Float[Array, "4"]:
    """|w| <= limit, in rad/s."""
    return jnp.concatenate([limit[None], state[10:13]])


def within_tilt(state, control, time, limit: Scalar) -> Float[Array, "3"]:
    """Angle between the body's z axis and the vertical <= limit, in rad.

    Its cosine is 1 - 2 (x^2 + y^2), so that this is |(x, y)| <= sin(limit / 2): convex.
    """
    return jnp.concatenate([jnp.sin(0.5 * limit)[None], state[7:9]])


def within_thrust_rate(first, last, width: Scalar | float, limit: Scalar) -> Float[Array, "rows"]:
    """|du/dt| <= limit, in N/s, as time that the change leaves over: s - |u_{i+1} - u_i| / (limit width).

    Thrust and dilation are linear in scaled time, so that the rate is greatest at the end with less dilation.
    """
    change = (last[:-1] - first[:-1]) / (limit * width)
    dilation = jnp.stack([first[-1], last[-1]])[:, None]
    return jnp.concatenate([dilation - change, dilation + change]).ravel()


class Zones(eqx.Module):
    """Parameters of ``outside_zones`` and ``inside_zone``: ellipsoids {p : |shape (p - centre)| <= 1}."""

    centres: Float[Array, "*nodes 3"]
    shapes: Float[Array, "*nodes 3 3"]


def outside_zones(state, control, time, p: Zones) -> Float[Array, "zones"]:
    """How far outside each ellipsoid, in m (exact for balls): (|shape (p - centre)| - 1) times the least semi-axis.

    Not convex. At a centre itself any way out is as good as another; a nudge of a micrometre picks one.
    """
    away = jnp.einsum("zrc,zc->zr", p.shapes, state[:3] + NUDGE - p.centres)
    distance = jnp.sqrt(jnp.sum(away * away, axis=1))
    return (distance - 1.0) / jnp.sqrt(jnp.max(jnp.sum(p.shapes**2, axis=2), axis=1))


def inside_zone(state, control, time, p: Zones) -> Float[Array, "4"]:
    """Inside one ellipsoid: |shape (p - centre)| <= 1."""
    return jnp.concatenate([jnp.ones(1, state.dtype), p.shapes @ (state[:3] - p.centres)])
