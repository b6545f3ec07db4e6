"""The deepest ball against a linear-programming library."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

from jaxscp.corridor import Polytope, box
from jaxscp.corridor.overlaps import deepest_ball, intersect


@pytest.mark.parametrize("empty", [False, True])
def test_the_radius_is_that_of_the_linear_program(empty):
    rng = np.random.default_rng(0)
    for _ in range(30):
        normals = rng.normal(size=(40, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        offsets = rng.uniform(-0.5 if empty else 0.1, 3.0, 40) + normals @ rng.normal(0, 20, 3)
        exact = linprog(
            [0, 0, 0, -1], np.column_stack([normals, np.ones(40)]), offsets, bounds=[(None, None)] * 4
        )
        padded = Polytope(
            jnp.asarray(np.concatenate([normals, np.zeros((8, 3))])),
            jnp.asarray(np.append(offsets, np.ones(8))),
        )
        assert float(deepest_ball(padded).radius) == pytest.approx(exact.x[3], abs=1e-9)


def test_the_ball_in_an_overlap_of_boxes_is_in_its_middle():
    ball = deepest_ball(intersect(box([0, 0, 0], [4, 2, 3]), box([3, 0, 0], [9, 2, 3])))
    assert float(ball.radius) == pytest.approx(0.5)
    np.testing.assert_allclose(ball.centre, [3.5, 1.0, 1.5], atol=1e-6)


def test_boxes_that_do_not_meet_have_a_negative_radius():
    ball = deepest_ball(intersect(box([0, 0, 0], [1, 1, 1]), box([2, 0, 0], [3, 1, 1])))
    assert float(ball.radius) == pytest.approx(-0.5)
