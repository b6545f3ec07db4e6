"""Lower and upper limits of states and controls."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative
from jaxscp.core.arrays import components, floats
from jaxscp.core.errors import InvalidProblem
from jaxscp.problem.constraint import AtNodes, Constraint, Throughout


class Side(eqx.Module):
    """One side of the limits: which vector, which of its components, and the sign of a slack."""

    of_control: bool = eqx.field(static=True)
    upper: bool = eqx.field(static=True)
    chosen: tuple[int, ...] | None = eqx.field(static=True)
    """None for one limit of all components."""
    size: int = eqx.field(static=True, default=0)
    """Number of limits that were given; of any vector for one limit of all."""


class WithinBounds(eqx.Module):
    """Slacks of the limits: the values of ``bounds``."""

    sides: tuple[Side, ...] = eqx.field(static=True)

    def __call__(self, state, control, time, limits) -> Float[Array, "rows"]:
        """Slacks, in the order of the sides."""
        rows = []
        for side, limit in zip(self.sides, limits, strict=True):
            vector = control if side.of_control else state
            if side.chosen is not None and side.size != vector.shape[0]:
                which = "controls" if side.of_control else "states"
                raise ValueError(f"bounds was given {side.size} limits of {vector.shape[0]} {which}")
            part = components(vector, side.chosen)
            slack = limit - part if side.upper else part - limit
            rows.append(
                jnp.where(limit == (jnp.inf if side.upper else -jnp.inf), 1.0, slack)
            )  # none, if traced
        return jnp.concatenate(rows)


def bounds(state: Any = None, control: Any = None, name: str = "") -> Constraint:
    """Limits of states and controls, at every point.

    Args:
        state: (lower, upper); each one number for all components, or one for each. None or an infinite number is no
            limit.
        control: the same.
        name: for reports.

    Raises:
        InvalidProblem: if there is no limit at all, or no pair.

    Example:
        >>> import jaxscp
        >>> limits = jaxscp.bounds(state=([None, -2.0], [None, 2.0]), control=(-1.0, 1.0))
        >>> limits.name
        'bounds'
    """
    sides, limits = [], []
    for of_control, pair in ((False, state), (True, control)):
        if pair is not None and (not isinstance(pair, tuple | list) or len(pair) != 2):
            which = "control" if of_control else "state"
            raise InvalidProblem(f"bounds: {which} takes a pair (lower, upper), got {pair!r}")
        for upper, limit in enumerate(pair if pair is not None else ()):
            chosen, values = _limited(limit)
            if values is not None:
                sides.append(Side(of_control, bool(upper), chosen, np.size(limit)))
                limits.append(values)
    if not sides:
        raise InvalidProblem("bounds: no limit is given; pass state=(lower, upper) or control=(lower, upper)")
    default = "bounds" if state is not None and control is not None else "state bounds"
    default = "control bounds" if state is None else default
    # Controls are linear or constant between nodes, so that limits that hold at both hold between them.
    where = AtNodes() if state is None else Throughout()
    return Constraint(
        WithinBounds(tuple(sides)),
        NonNegative(),
        tuple(limits),
        where=where,
        convex=True,
        name=name or default,
    )


def control_bounds(constraint: Constraint) -> Iterator[tuple[Side, Array]]:
    """The limits of controls that ``bounds`` states; none for another constraint."""
    if isinstance(constraint.function, WithinBounds):
        for side, limit in zip(constraint.function.sides, constraint.parameters, strict=True):
            if side.of_control:
                yield side, limit


def _limited(limit: Any) -> tuple[tuple[int, ...] | None, Array | None]:
    """Components that are limited, None for all, and their limits, None for none."""
    if limit is None or _infinite(limit):
        return None, None
    if np.ndim(limit) == 0:
        return None, floats(limit)
    chosen = tuple(i for i, v in enumerate(limit) if v is not None and not _infinite(v))
    if not chosen:
        return None, None
    return chosen, floats([limit[i] for i in chosen])


def _infinite(value: Any) -> bool:
    return not isinstance(value, Tracer) and np.ndim(value) == 0 and bool(np.isinf(float(value)))
