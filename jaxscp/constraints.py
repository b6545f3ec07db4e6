"""A constraint is a function of (state, control, time, parameters of that node) and the cone it must lie in.

Functions that are affine are kept exactly by linearisation; others are linearised anew at every iteration.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class Cone(eqx.Module):
    """A convex cone that a constraint's values must lie in."""


class Zero(Cone):
    """Every value is zero: an equality."""


class NonNegative(Cone):
    """Every value is zero or more."""


class SecondOrder(Cone):
    """The values (t, v) obey |v| <= t."""


class Constraint(eqx.Module):
    """``function(state, control, time, parameters)`` lies in ``cone`` at every active node.

    Args:
        function: a pure function defined at module level; returns one axis of values.
        parameters: a pytree whose arrays have the nodes as leading axis.
        cone: ``Zero()``, ``NonNegative()`` or ``SecondOrder()``.
        active: (nodes,) whether the constraint holds at a node.
        name: what reports call it.
        of_controls: whether it is an affine function of the controls alone. Those are linear between the nodes, so
            that what holds at the nodes holds everywhere.

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
    of_controls: bool = eqx.field(default=False, static=True)


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
    """p_f: the landing point in m."""
    cotangent: Float[Array, "*nodes"]
    """cot(gamma_c): gamma_c is the angle of the cone's side above the deck."""


def inside_landing_cone(state, control, time, p: LandingCone) -> Float[Array, "3"]:
    """Horizontal distance bounded by cot(gamma_c) times the height above the deck (equations 21-22)."""
    offset = state[:3] - p.apex
    return jnp.concatenate([(p.cotangent * offset[2])[None], offset[:2]])


class Limits(eqx.Module):
    """Parameters of ``within_control_limits``."""

    lower: Float[Array, "*nodes controls"]
    upper: Float[Array, "*nodes controls"]


def within_control_limits(state, control, time, p: Limits) -> Float[Array, "rows"]:
    """u_min <= u <= u_max (equation 23)."""
    return jnp.concatenate([control - p.lower, p.upper - control])


def repeat_over_nodes(parameters: Any, nodes: int) -> Any:
    """Give parameters that do not vary a leading axis of nodes."""
    return jax.tree.map(lambda p: jnp.broadcast_to(p, (nodes, *jnp.shape(p))), parameters)
