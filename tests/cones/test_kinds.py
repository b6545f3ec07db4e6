"""Sorting by the kind of cone."""

import pytest

from jaxscp.cones.cone import Cone, NonNegative, SecondOrder, Zero
from jaxscp.cones.kinds import by_cone


def test_every_kind_has_its_positions():
    found = by_cone([SecondOrder(), Zero(), NonNegative(), SecondOrder()])
    assert found == ([1], [2], [0, 3])


def test_a_cone_of_another_kind_is_named():
    class Power(Cone):
        """Of no convex program here; its algebra is not asked for."""

    Power.__abstractmethods__ = frozenset()
    with pytest.raises(TypeError, match="the convex programs hold Zero, NonNegative, SecondOrder, not Power"):
        by_cone([NonNegative(), Power()])
