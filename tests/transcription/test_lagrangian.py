"""The augmented Lagrangian, the merit function of steps, and its projections."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp.cones.cone import NonNegative, SecondOrder
from jaxscp.transcription.lagrangian import Merit, Residual, no_multipliers, residual
from jaxscp.transcription.shooting import Grid, evaluate
from tests.support.flights import random_nodes, short_problem

ROUNDING = 1e-10
vectors = st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3).map(jnp.array)


@settings(max_examples=50, deadline=None)
@given(vectors)
def test_a_vector_splits_into_its_part_in_the_cone_and_one_in_its_polar(v):
    """Moreau: v = P(v) - P(-v) with orthogonal P(v) and P(-v), for a self-dual cone."""
    for cone in (NonNegative(), SecondOrder()):
        inside, outside = cone.project_dual(v), cone.project_dual(-v)
        np.testing.assert_allclose(inside - outside, v, atol=ROUNDING)
        np.testing.assert_allclose(jnp.vdot(inside, outside), 0.0, atol=1e-8)
        np.testing.assert_allclose(cone.project_dual(inside), inside, atol=ROUNDING)


@pytest.mark.slow
def test_merit_of_a_feasible_point_is_its_cost():
    problem = short_problem()
    z = random_nodes(problem, 0)
    out = evaluate(problem, z, Grid())
    inside = tuple(
        jnp.ones_like(v) * jnp.array([3.0, 1.0, 1.0])[: v.shape[-1]] if v.shape[-1] == 3 else jnp.ones_like(v)
        for v in out.values
    )
    point = Residual(jnp.asarray(7.0), jnp.zeros_like(out.end), inside, jnp.zeros(13), jnp.zeros(12))
    merit = Merit(problem, no_multipliers(problem, z, Grid()), 10.0, jnp.ones(13))
    np.testing.assert_allclose(merit(point), 7.0)


@pytest.mark.slow
def test_merit_grows_with_every_residual():
    problem = short_problem()
    z = random_nodes(problem, 0)
    out = evaluate(problem, z, Grid())
    point, y = residual(problem, z, out), no_multipliers(problem, z, Grid())
    merit = Merit(problem, y, 10.0, jnp.ones(13))
    base = merit(point)
    worse = dataclasses.replace(point, defect=2.0 * point.defect)
    outside = dataclasses.replace(point, values=tuple(v - 5.0 for v in point.values))
    assert float(merit(worse)) > float(base)
    assert float(merit(outside)) > float(base)
