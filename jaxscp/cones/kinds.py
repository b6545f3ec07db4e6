"""Sorting by the kind of cone."""

from collections.abc import Iterable
from typing import NamedTuple

from jaxscp.cones.cone import Cone, NonNegative, SecondOrder, Zero


class ByCone(NamedTuple):
    """Positions of constraints, by the kind of their cones."""

    zero: list[int]
    nonnegative: list[int]
    second_order: list[int]


def by_cone(cones: Iterable[Cone]) -> ByCone:
    """Positions of each kind of cone.

    Raises:
        TypeError: for a cone of another kind, which the convex programs cannot hold.

    Example:
        >>> from jaxscp.cones.cone import NonNegative, SecondOrder
        >>> from jaxscp.cones.kinds import by_cone
        >>> by_cone([NonNegative(), SecondOrder(), NonNegative()])
        ByCone(zero=[], nonnegative=[0, 2], second_order=[1])
    """
    kinds, numbered = (Zero, NonNegative, SecondOrder), list(enumerate(cones))
    for _, cone in numbered:
        if not isinstance(cone, kinds):
            names = ", ".join(kind.__name__ for kind in kinds)
            raise TypeError(f"cone: the convex programs hold {names}, not {type(cone).__name__}")
    return ByCone(*([i for i, cone in numbered if isinstance(cone, kind)] for kind in kinds))
