"""A constraint: a function of (state, control, time, parameters), and the cone that its values lie in.

Linearisation keeps affine functions exactly. It replaces others anew at every iteration.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscp.cones.cone import Cone
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Scalar

DISTANCE_TOLERANCE = 1e-3  # m: a violation of a distance that counts as none


class Where(eqx.Module):
    """The part of the trajectory on which a constraint holds."""

    nodal: ClassVar[bool] = False
    """Whether the constraint holds at nodes alone; else in intervals."""
    across: ClassVar[bool] = False
    """Whether its function takes the controls at both ends of an interval."""

    @property
    def throughout(self) -> bool:
        """Whether the constraint holds at every point of an interval."""
        return not (self.nodal or self.across)


class Throughout(Where):
    """In the intervals of its active nodes: at the nodes and, by methods that can, between them."""


class AtNodes(Where):
    """At its active nodes alone.

    For gates, and for affine functions of the controls: controls are linear between nodes, so that such a
    constraint holds between two nodes if it holds at both.
    """

    nodal: ClassVar[bool] = True


class AcrossIntervals(Where):
    """In the intervals of its active nodes, on the controls at both ends.

    The function's arguments are (first, last, width, parameters): the controls at both ends, with the dilation last,
    and the interval's width in scaled time.
    """

    across: ClassVar[bool] = True


def _flags(active: Any) -> Any:
    """Flags as JAX's array, from a list or a NumPy array."""
    if not isinstance(active, list | tuple | np.ndarray):
        return active
    values = np.asarray(active)
    if values.dtype != bool and not np.isin(values, (0, 1)).all():
        raise InvalidProblem(f"active: expected flags, True or False for each node; got {active!r}.")
    return jnp.asarray(values, bool)


class Constraint(eqx.Module):
    """``function(state, control, time, parameters)`` lies in ``cone``.

    Args:
        function: a pure function; returns one axis of values.
        cone: ``Zero()``, ``NonNegative()`` or ``SecondOrder()``.
        parameters: a pytree of numbers and arrays.
        per_node: whether arrays of ``parameters`` have the nodes as leading axis. Node k's values hold in the whole
            interval after it.
        active: (nodes,) whether the constraint holds at a node; None is everywhere.
        where: ``Throughout()``, ``AtNodes()`` or ``AcrossIntervals()``.
        convex: whether the feasible set is convex. The linearisation of another constraint may contradict the rest
            far from a solution; subproblems may then violate it at a penalty (virtual buffer).
        tolerance: violation that counts as none, in the unit of the values; None is 1e-3, times the values' typical
            size if the problem has a scale.
        name: for reports; by default the function's.
        soft: None, or a weight: the constraint may be violated, at this cost per unit of violation and second.

    Example:
        >>> import jaxscp
        >>> def above_floor(state, control, time, height):
        ...     return state[2:3] - height
        >>> floor = jaxscp.Constraint(above_floor, jaxscp.NonNegative(), 0.3, convex=True)
    """

    function: Callable[..., Any] = eqx.field(static=True)
    cone: Cone
    parameters: Any = ()
    per_node: bool = eqx.field(default=False, static=True)
    active: Bool[Array, "nodes"] | None = eqx.field(default=None, converter=_flags)
    where: Where = Throughout()
    convex: bool = eqx.field(default=False, static=True)
    tolerance: Scalar | float | None = None
    name: str = eqx.field(default="", static=True)
    soft: Scalar | float | None = None

    def node_parameters(self) -> Any:
        """Those that differ from node to node; the others belong to ``value``."""
        return self.parameters if self.per_node else ()

    def with_parameters(self, function: Callable[..., Array]) -> Callable[..., Array]:
        """A function whose last argument is one of ``node_parameters``."""
        if self.per_node:
            return function
        return lambda *arguments: function(*arguments[:-1], self.parameters)

    def value(self, state, control, time, node_parameters: Any) -> Float[Array, "rows"]:
        """Values at a point."""
        return self.with_parameters(self.function)(state, control, time, node_parameters)

    def active_in_intervals(self, points: int) -> Bool[Array, "intervals points"]:
        """Points of every interval at which the constraint holds.

        It holds in the intervals of its active nodes, and at the last node only if active there: a landing cone, say,
        is left out at its apex, where the end condition holds the vehicle.
        """
        assert self.active is not None, "of a problem over scaled time"
        last_node = np.zeros((self.active.shape[0] - 1, points), bool)
        last_node[-1, -1] = points > 1
        return self.active[:-1, None] & (self.active[-1] | ~last_node)

    def active_at_locations(self, points: int) -> Bool[Array, "locations points"]:
        """The same for its own locations: nodes for ``AtNodes``, else intervals."""
        assert self.active is not None, "of a problem over scaled time"
        return self.active[:, None] if self.where.nodal else self.active_in_intervals(points)


def name_of(function: Callable[..., Any]) -> str:
    """Name of a function, for reports; empty for a lambda."""
    name = getattr(function, "__name__", type(function).__name__)
    return "" if name == "<lambda>" else name.strip("_").replace("_", " ")


def repeat_over_nodes(parameters: Any, nodes: int) -> Any:
    """Parameters with a leading axis of nodes, the same at every node."""
    return jax.tree.map(lambda p: jnp.broadcast_to(p, (nodes, *jnp.shape(p))), parameters)
