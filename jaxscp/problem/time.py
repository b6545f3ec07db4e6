"""The final time, free or fixed, and the number of nodes."""

from typing import Any

import equinox as eqx
from jaxtyping import Array

from jaxscp.core.arrays import floats
from jaxscp.core.types import Scalar

MESH_WEIGHT = 3e-4  # cost that is lost to an even mesh, at most
_AT_LIMIT = 1e-3  # of a limit: a final time that near to it is at it


def _number(value: Any) -> Array | None:
    return None if value is None else floats(value)


def _pair(value: Any) -> tuple[Array, Array] | None:
    return None if value is None else (floats(value[0]), floats(value[1]))


class FreeTime(eqx.Module):
    """A final time between two limits.

    Args:
        lower: least final time in s.
        upper: greatest final time in s.
        dilation: (least, greatest) dt/dtau in s, the time that a node's neighbourhood may stretch to. By default both
            limits above serve, which keeps the mesh near uniform where the final time is near one of them. With it,
            time becomes a state.
    """

    lower: Scalar = eqx.field(converter=floats)
    upper: Scalar = eqx.field(converter=floats)
    dilation: tuple[Scalar, Scalar] | None = eqx.field(converter=_pair, default=None)


class FixedTime(eqx.Module):
    """A final time that is given, on a mesh that is uniform in time.

    Args:
        duration: in s.
    """

    duration: Scalar = eqx.field(converter=floats)


def limit_reached(final: FreeTime | FixedTime, last: float) -> str:
    """Words about a final time at one of its limits; empty for one that is fixed, or between them.

    Example:
        >>> limit_reached(FreeTime(1.0, 5.0), 5.0)
        'the final time is at its upper limit, 5 s: a flight may need more'
    """
    if isinstance(final, FixedTime):
        return ""
    for name, limit, needed in (("upper", float(final.upper), "more"), ("lower", float(final.lower), "less")):
        if abs(last - limit) <= _AT_LIMIT * limit:
            return f"the final time is at its {name} limit, {limit:g} s: a flight may need {needed}"
    return ""


class Time(eqx.Module):
    """Nodes and final time; the start is at zero.

    Args:
        nodes: N; the trajectory has N - 1 intervals.
        final: ``FreeTime(...)`` or ``FixedTime(...)``.
        mesh_weight: with a free final time, cost of half the squared change of dt/dtau between neighbours, in
            ``mesh_unit``. Many meshes are equally good, or nearly so; this picks an even one. None is no such cost.
        mesh_unit: unit of time for that cost in s; None is the duration of the guess. With a unit of the problem's own,
            the optimum and its derivatives do not depend on the guess.

    Example:
        >>> import jaxscp
        >>> free = jaxscp.Time(nodes=30, final=jaxscp.FreeTime(1.0, 20.0))
        >>> fixed = jaxscp.Time(nodes=30, final=jaxscp.FixedTime(4.0))
    """

    nodes: int = eqx.field(static=True)
    final: FreeTime | FixedTime
    mesh_weight: Scalar | None = eqx.field(converter=_number, default=MESH_WEIGHT)
    mesh_unit: Scalar | None = eqx.field(converter=_number, default=None)
