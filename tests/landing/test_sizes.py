"""Sizes of a mission, and the small cost of an uneven mesh that is the same in all units."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.landing.problem import MESH_WEIGHT
from jaxscp.landing.sizes import GRAVITY, HOVER, MASS, ROUTE, TYPICAL_TIME, sizes_of
from jaxscp.landing.units import units_of
from jaxscp.problem.form import Continuous, Paper

ROUNDING = 1e-12
LOST = 1e-3  # of the cost: to an even mesh, at most
NODES = 30


@pytest.fixture(scope="module")
def scenario():
    return jaxscp.scenarios.ascent_to_platform()


def mesh_cost_factor(scenario, form=Continuous()):  # noqa: B008
    """Factor of half the squared change of dt/dtau, in the scenario's own units."""
    problem, _ = scenario.problem(NODES, form)
    return problem.time.mesh_weight / problem.time.mesh_unit**2


def test_sizes_are_one_in_the_solvers_units(scenario):
    own, _ = scenario.in_solver_units(Continuous())
    np.testing.assert_allclose(jax.tree.leaves(sizes_of(own)), 1.0, rtol=ROUNDING)
    np.testing.assert_allclose(own.airframe.body.mass, MASS, rtol=ROUNDING)
    np.testing.assert_allclose(jnp.linalg.norm(own.airframe.body.gravity), GRAVITY, rtol=ROUNDING)
    route = jnp.concatenate([own.start.position[None], own.corridor.joints, own.goal.position[None]])
    length = jnp.sum(jnp.linalg.norm(jnp.diff(route, axis=0), axis=1))
    assert 0.9 * ROUTE < float(length) <= ROUTE  # the vehicle's own size is the rest
    hover = jnp.linalg.norm(own.airframe.body.hover_thrust())
    np.testing.assert_allclose(own.weights.control * hover + own.weights.time, HOVER, rtol=ROUNDING)


def test_the_mesh_costs_the_same_in_all_units(scenario):
    """A cost over the square of a time."""
    own, _ = scenario.in_solver_units(Continuous())
    units = units_of(scenario)
    expected = mesh_cost_factor(own) * units.cost / units.time**2
    np.testing.assert_allclose(mesh_cost_factor(scenario), expected, rtol=ROUNDING)
    np.testing.assert_allclose(mesh_cost_factor(own), MESH_WEIGHT / TYPICAL_TIME**2, rtol=ROUNDING)


def test_the_papers_form_has_no_such_cost(scenario):
    problem, _ = scenario.problem(NODES, Paper())
    assert problem.time.mesh_weight is None


def test_derivatives_are_finite_where_a_leg_of_the_route_has_no_length(scenario):
    """Unused joints of a padded corridor lie at the goal."""
    padded = jaxscp.corridor.pad(scenario.corridor, scenario.goal.position, polytopes=6)

    def factor(start, goal):
        ends = scenario.start, scenario.goal
        start, goal = (dataclasses.replace(s, position=p) for s, p in zip(ends, (start, goal), strict=True))
        return mesh_cost_factor(dataclasses.replace(scenario, start=start, goal=goal, corridor=padded))

    slopes = jax.grad(factor, argnums=(0, 1))(scenario.start.position, scenario.goal.position)
    assert bool(jnp.all(jnp.isfinite(jnp.concatenate(slopes))))
    assert bool(jnp.any(slopes[0] != 0.0))


def test_derivatives_are_finite_without_gravity(scenario):
    """There is no time of a fall then: it is one."""
    floating = eqx.tree_at(lambda s: s.airframe.body.gravity, scenario, jnp.zeros(3))

    def factor(start):
        there = dataclasses.replace(floating.start, position=start)
        return mesh_cost_factor(dataclasses.replace(floating, start=there))

    value, slope = jax.value_and_grad(factor)(floating.start.position)
    assert float(value) > 0.0
    assert bool(jnp.all(jnp.isfinite(slope)))


@pytest.mark.slow
def test_an_even_mesh_costs_little(scenario):
    """Without its cost, the mesh is less even, and the plan hardly cheaper."""
    planner = jaxscp.Planner(nodes=NODES)
    plan = planner(scenario)
    problem, _ = scenario.problem(NODES, context=plan.context)
    sizes = (jnp.ones(n) for n in (problem.dynamics.state_size, problem.dynamics.control_size))
    unit = jaxscp.Scale(
        *sizes, time=1.0, cost=1.0
    )  # about those of a landing, so that the barrier costs as much
    time = dataclasses.replace(problem.time, mesh_weight=None)
    free = dataclasses.replace(problem, time=time, scale=unit)
    best = jaxscp.solve(free, plan.trajectory)
    assert best.status == jaxscp.Status.converged
    assert -ROUNDING < float(plan.cost / best.cost) - 1.0 < LOST

    def unevenness(solution):
        return float(jnp.sum(jnp.diff(solution.trajectory.dilation) ** 2))

    assert unevenness(plan) < unevenness(best)
