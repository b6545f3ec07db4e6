"""Parts of a mission from plain numbers: what contradicts itself is named."""

import numpy as np
import pytest

import jaxscp


@pytest.mark.parametrize(
    ("centres", "semi_axes"),
    [
        ([[3.0, 2.0]], 0.3),
        ([[3.0, 2.0, 1.0]], [0.3] * 4),
        ([[3.0, 2.0, 1.0]] * 2, [[0.3, 0.3]] * 2),
        ([[3.0, 2.0, 1.0]], -0.5),
    ],
)
def test_ellipsoids_that_contradict_themselves_are_refused(centres, semi_axes):
    with pytest.raises(ValueError, match="ellipsoids: "):
        jaxscp.ellipsoids(centres, semi_axes)


@pytest.mark.parametrize("semi_axes", [0.5, [0.5], [0.5, 0.5], [[0.5, 0.5, 0.5]], [[0.5] * 3] * 2])
def test_balls_may_be_stated_in_any_way(semi_axes):
    found = jaxscp.ellipsoids([[3.0, 2.0, 1.0], [1.0, 2.0, 1.0]], semi_axes)
    np.testing.assert_array_equal(found.shapes, np.broadcast_to(2.0 * np.eye(3), (2, 3, 3)))


def test_fixed_components_name_what_is_wrong():
    np.testing.assert_array_equal(jaxscp.fixed(attitude=0.0).attitude, np.zeros(3))
    with pytest.raises(ValueError, match="attitude: expected three numbers, got shape"):
        jaxscp.fixed(attitude=[1.0, 1.0])
    with pytest.raises(ValueError, match="position: expected three numbers, got"):
        jaxscp.fixed(position="a")
