"""Flow over intervals: equal to the discretisation's flow, exact Jacobians, safe margins."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.dynamics.rotations import from_yaw
from jaxscp.landing.problem import Pose, same_pose
from jaxscp.transcription.discretise import propagate
from jaxscp.transcription.layout import interval_variables
from jaxscp.transcription.shooting import Grid, evaluate, linearise
from tests.support.flights import random_nodes, short_problem

ROUNDING = 1e-12
RK6_ERROR = 1e-5  # m and rad/s, error of five steps if a vehicle turns by about a radian an interval
SIXTH_ORDER = (35.0, 130.0)  # range of the error ratio for half the step: 64 in the limit
SLOPE = 1e-6  # relative; central differences of 1e-6 in values near one
DIP = 5e-4  # m; error of the second-order margin if curvature changes within an interval


@pytest.fixture(scope="module")
def problem():
    return short_problem()


def test_the_flow_is_the_discretisations(problem):
    """Compared with another method with so many steps that its error is negligible."""
    problem, z = dataclasses.replace(problem, mesh_weight=None), random_nodes(problem, 0)
    end, cost = propagate(problem, z, 200)
    out = evaluate(problem, z, Grid())
    np.testing.assert_allclose(out.end, end, rtol=RK6_ERROR, atol=RK6_ERROR)
    np.testing.assert_allclose(out.cost, cost, rtol=RK6_ERROR)


def test_error_falls_with_the_sixth_power_of_the_steps(problem):
    z = random_nodes(problem, 0)
    coarse, middle, fine = (eqx.filter_jit(evaluate)(problem, z, Grid(steps=k)).end for k in (1, 2, 8))
    gain = jnp.max(jnp.abs(coarse - fine)) / jnp.max(jnp.abs(middle - fine))
    assert SIXTH_ORDER[0] < float(gain) < SIXTH_ORDER[1]


def test_jacobians_are_differences(problem):
    z = random_nodes(problem, 1)
    linear = jax.jit(lambda z: linearise(problem, z, Grid()))(z)
    values = jax.jit(lambda z: evaluate(problem, z, Grid()))
    direction = jnp.asarray(np.random.default_rng(2).standard_normal(z.shape))
    h = 1e-6
    w = interval_variables(problem, direction)
    plus, minus = values(z + h * direction), values(z - h * direction)
    for jacobian, a, b in zip(*map(jax.tree.leaves, (linear.jacobian, plus, minus)), strict=True):
        slope = jnp.einsum("i...w,iw->i...", jacobian, w)
        np.testing.assert_allclose(slope, (a - b) / (2.0 * h), rtol=SLOPE, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_dips_below_the_margin_between_points(problem, seed):
    """Values on a grid twenty times as fine are never below the line through the constrained ones."""
    z = random_nodes(problem, seed)
    coarse = evaluate(problem, z, Grid()).values[0]
    bare = eqx.filter_jit(evaluate)(problem, z, Grid(subintervals=100)).values[
        0
    ]  # its margin is 400 times smaller
    lowest = bare.reshape(*bare.shape[:2], -1).min(axis=1)
    assert float(jnp.max(coarse.min(axis=1) - lowest)) < DIP
    assert float(jnp.max(lowest - coarse.min(axis=1))) > 1e-3  # the margin is not zero


def test_limits_of_controls_hold_at_nodes_alone(problem):
    values = evaluate(problem, random_nodes(problem, 3), Grid()).values
    assert [v.shape[1] for v in values] == [6, 1, 6]


def test_the_cone_is_left_out_at_its_apex(problem):
    cone = problem.constraints[2]
    active = cone.active_in_intervals(6)
    assert bool(active[-1, -2])
    assert not bool(active[-1, -1])
    assert not bool(active[0].any())


def test_a_grid_too_coarse_for_a_margin_is_refused():
    with pytest.raises(ValueError, match="subintervals"):
        Grid(subintervals=2)


def test_either_sign_of_a_quaternion_is_the_goal():
    goal = jnp.zeros(13).at[6:10].set(from_yaw(0.3))
    other = goal.at[6:10].multiply(-1.0)
    missed = same_pose(other, None, Pose(goal, jnp.zeros(3), jnp.ones(12)))
    assert missed.shape == (12,)
    np.testing.assert_allclose(missed, 0.0, atol=ROUNDING)
