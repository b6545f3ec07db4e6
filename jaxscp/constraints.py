"""A constraint is a function of (state, control, time, parameters of that node) and the cone it must lie in.

Functions that are affine are kept exactly by linearisation; others are linearised anew at every iteration.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.types import Scalar

NUDGE = 1e-6  # m
DISTANCE = 1e-3  # m: violation of a distance that counts as none


class Cone(eqx.Module):
    """A convex cone that a constraint's values must lie in."""


class Zero(Cone):
    """Every value is zero: an equality."""


class NonNegative(Cone):
    """Every value is zero or more."""


class SecondOrder(Cone):
    """The values (t, v) obey |v| <= t."""


class Where(eqx.Module):
    """Where on the flight a constraint holds."""


class Throughout(Where):
    """In the intervals of its active nodes: at the nodes and, by methods that can, between them."""


class AtNodes(Where):
    """At its active nodes alone: gates; and affine functions of the controls, which are linear between nodes, so
    that what holds at the nodes holds everywhere."""


class AcrossIntervals(Where):
    """In the intervals of its active nodes, on the controls at both ends.

    The function's arguments are (first, last, width, parameters): the controls, with the dilation last, at both
    ends, and the interval's width in scaled time.
    """


class Constraint(eqx.Module):
    """``function(state, control, time, parameters)`` lies in ``cone``.

    Args:
        function: a pure function defined at module level; returns one axis of values.
        parameters: a pytree whose arrays have the nodes as leading axis.
        cone: ``Zero()``, ``NonNegative()`` or ``SecondOrder()``.
        active: (nodes,) whether the constraint holds at a node.
        name: what reports call it.
        where: ``Throughout()``, ``AtNodes()`` or ``AcrossIntervals()``.
        convex: whether the linearised constraint is no stricter than the true one can be kept. One that is not
            may contradict the others far from a solution: subproblems may then buy violations of it (virtual
            buffer).
        allowed: violation that counts as none, in the unit of the values.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.constraints import Constraint, NonNegative
        >>> def floor(state, control, time, height):
        ...     return state[2:3] - height
        >>> Constraint(floor, jnp.full((5, 1), 0.3), NonNegative(), jnp.ones(5, bool), "floor").name
        'floor'
    """

    function: Callable[..., Array] = eqx.field(static=True)
    parameters: Any
    cone: Cone
    active: Bool[Array, "nodes"]
    name: str = eqx.field(static=True)
    where: Where = Throughout()
    convex: bool = eqx.field(default=True, static=True)
    allowed: Scalar | float = DISTANCE


# --- the functions that landing problems use ---


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
    """Distance along the deck bounded by cot(gamma_c) times the height above it (equations 21-22).

    The landing point is affine in time, so that the cone stays convex with time as a state.
    """
    apex = p.apex if time is None else p.apex + p.velocity * time
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


def within_thrust_rate(first, last, width: float, limit: Scalar) -> Float[Array, "rows"]:
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


def repeat_over_nodes(parameters: Any, nodes: int) -> Any:
    """Give parameters that do not vary a leading axis of nodes."""
    return jax.tree.map(lambda p: jnp.broadcast_to(p, (nodes, *jnp.shape(p))), parameters)
