"""A constraint is a function of (state, control, time, parameters of that node) and the cone it must lie in.

Functions that are affine are kept exactly by linearisation; others are linearised anew at every iteration.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxscp.cones.cone import Cone
from jaxscp.core.types import Scalar

DISTANCE = 1e-3  # m: violation of a distance that counts as none


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
        >>> from jaxscp.problem.constraint import Constraint, NonNegative
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


def repeat_over_nodes(parameters: Any, nodes: int) -> Any:
    """Give parameters that do not vary a leading axis of nodes."""
    return jax.tree.map(lambda p: jnp.broadcast_to(p, (nodes, *jnp.shape(p))), parameters)
