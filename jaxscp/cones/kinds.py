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

    Example:
        >>> from jaxscp.cones.cone import NonNegative, SecondOrder
        >>> from jaxscp.cones.kinds import by_cone
        >>> by_cone([NonNegative(), SecondOrder(), NonNegative()])
        ByCone(zero=[], nonnegative=[0, 2], second_order=[1])
    """
    numbered = list(enumerate(cones))
    return ByCone(
        *([i for i, c in numbered if isinstance(c, kind)] for kind in (Zero, NonNegative, SecondOrder))
    )
