"""Derivatives of plans: closed forms, laws of invariance, finite differences, and plans without a derivative."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import NewtonSCP, scenarios
from jaxscp.nlp.central_path import Point, conditions
from jaxscp.problem.node_values import node_times
from jaxscp.scp.method import iterate
from tests.system.test_general_problem import LEAST, LIMIT, SWITCH, rest_to_rest, straight

DISTANCE = 4.0
RESIDUAL = 1e-7  # residual of the optimality conditions at the returned point
BARRIER = 1e-3  # relative; effect of the barrier and of the shortest interval on a minimum time
LAW = 1e-4  # relative; the relaxation of constraints does not scale, and breaks scaling laws by this much
ROUNDING = 1e-8  # error of sums of gradients that cancel
DIFFERENCES = 1e-4  # relative; error of central differences of new plans
MIRROR = 1e-6  # relative; eigenvectors round differently in a mirror, so symmetric optima differ by this much
POLAR, AXIAL = jnp.array([1.0, -1.0, 1.0]), jnp.array([-1.0, 1.0, -1.0])  # vectors in a mirror across y


@pytest.fixture(scope="module")
def flight():
    """Minimum time from rest to rest, as a function of distance, limit and least dilation."""
    method = NewtonSCP()

    def plan(parameters):
        problem = rest_to_rest(*parameters)
        result = iterate(method, problem, straight(problem, DISTANCE, 5.0))
        return node_times(result.z[:, -1])[-1], (problem, result)

    parameters = jnp.array([DISTANCE, LIMIT, LEAST])
    return (
        parameters,
        jax.jit(jax.value_and_grad(plan, has_aux=True))(parameters),
        jax.jit(lambda p: plan(p)[0]),
    )


@pytest.mark.slow
def test_the_answer_is_a_root_of_the_conditions(flight):
    _, ((_, (problem, result)), _), _ = flight
    assert bool(result.is_optimum)
    point = Point(result.z, result.multipliers)
    residual = jax.jit(lambda p, v: conditions(p, v, NewtonSCP().grid))(problem, point)
    assert max(float(jnp.max(jnp.abs(v))) for v in jax.tree.leaves(residual)) < RESIDUAL


@pytest.mark.slow
def test_slopes_of_the_minimum_time(flight):
    """t_f = 2 sqrt(d / a), with derivatives t_f / (2 d) and -t_f / (2 a)."""
    _, ((time, _), slopes), _ = flight
    np.testing.assert_allclose(time, 2.0 * np.sqrt(DISTANCE / LIMIT), rtol=SWITCH)
    expected = [time / (2.0 * DISTANCE), -time / (2.0 * LIMIT)]
    np.testing.assert_allclose(slopes[:2], expected, rtol=BARRIER)


@pytest.mark.slow
def test_slopes_are_differences(flight):
    parameters, (_, slopes), plan = flight
    h = 1e-4 * parameters
    for i in range(3):
        step = jnp.zeros(3).at[i].set(h[i])
        slope = (plan(parameters + step) - plan(parameters - step)) / (2.0 * h[i])
        np.testing.assert_allclose(slopes[i], slope, rtol=DIFFERENCES, atol=1e-6)


@pytest.mark.slow
def test_second_derivatives_are_refused(flight):
    parameters, _, time = flight
    with pytest.raises(TypeError):  # no number may be returned; JAX may raise before our own rule raises
        jax.eval_shape(jax.hessian(time), parameters)


def test_paper_mode_has_no_derivative_and_says_so():
    scenario = scenarios.ascent_to_platform()
    planner = jaxscp.Planner(nodes=20, method=jaxscp.PTR())
    with pytest.raises(TypeError, match="no derivative"):
        jax.eval_shape(
            jax.grad(lambda a: planner(eqx.tree_at(lambda s: s.cone_angle, scenario, a)).cost), 0.8
        )


# --- whole plans ---


@pytest.fixture(scope="module")
def planned():
    """Cost and flight time of Case 1, and their gradients, as one compiled function of the scenario's floats."""
    scenario = dataclasses.replace(scenarios.platform_to_platform(), obstacles=None)
    scenario = eqx.tree_at(lambda s: s.weights.time, scenario, jnp.asarray(1.0))
    floats, rest = eqx.partition(scenario, eqx.is_inexact_array)
    planner = jaxscp.Planner()

    def both(floats):
        solution = planner(eqx.combine(floats, rest))
        return jnp.stack([solution.cost, solution.final_time]), solution.differentiable

    def with_gradients(floats):
        values, pull, differentiable = jax.vjp(both, floats, has_aux=True)
        return values, *(pull(jnp.eye(2)[i])[0] for i in range(2)), differentiable

    return floats, jax.jit(with_gradients)


@pytest.mark.nightly
def test_translating_the_whole_scene_changes_nothing(planned):
    floats, plan = planned
    _, *gradients, differentiable = plan(floats)
    assert bool(differentiable)
    for g in gradients:
        # a face n . p <= b moves with the scene by n . shift
        corridor = jnp.einsum("pf,pfc->c", g.corridor.offsets, floats.corridor.normals)
        joints = jnp.sum(g.corridor.joints, axis=0)  # the route's length gives the cost of an uneven mesh
        total = g.start.position + g.goal.position + corridor + joints
        assert float(jnp.max(jnp.abs(total))) < ROUNDING * max(1.0, float(jnp.max(jnp.abs(corridor))))


@pytest.mark.nightly
def test_a_heavier_world_takes_as_long(planned):
    """Mass, inertia and thrust limits times k: the same trajectory with k times the thrust.

    With the weight of effort divided by k, the cost is the same too.
    """
    floats, plan = planned
    values, of_cost, of_time, _ = plan(floats)

    def along(g):
        a, b = g.airframe, floats.airframe
        pairs = [
            (a.body.mass, b.body.mass),
            (a.body.inertia, b.body.inertia),
            (a.thrust_min, b.thrust_min),
            (a.thrust_max, b.thrust_max),
            (g.weights.control, -floats.weights.control),
        ]
        return float(sum(jnp.vdot(x, y) for x, y in pairs))

    assert abs(along(of_cost)) < LAW * float(values[0])
    assert abs(along(of_time)) < LAW * float(values[1])


def mirrored(s):
    """A scene, or a gradient with respect to one, mirrored across y; every rotor then turns the other way."""

    def body(b):
        turned = (
            POLAR[:, None] * b.thrust_map,
            AXIAL[:, None] * b.torque_map,
            POLAR[:, None] * b.inertia * POLAR,
        )
        return eqx.tree_at(
            lambda b: (b.thrust_map, b.torque_map, b.inertia, b.gravity), b, (*turned, POLAR * b.gravity)
        )

    def end(e):
        turned = (
            POLAR * e.position,
            POLAR * e.velocity,
            jnp.append(1.0, AXIAL) * e.attitude,
            AXIAL * e.body_rate,
        )
        return eqx.tree_at(lambda e: (e.position, e.velocity, e.attitude, e.body_rate), e, turned)

    corridor = (s.corridor.normals * POLAR, s.corridor.joints * POLAR)
    return eqx.tree_at(
        lambda s: (s.airframe.body, s.start, s.goal, s.corridor.normals, s.corridor.joints),
        s,
        (body(s.airframe.body), end(s.start), end(s.goal), *corridor),
    )


@pytest.mark.nightly
def test_a_mirrored_scene_has_mirrored_gradients(planned):
    floats, plan = planned
    values, *gradients, _ = plan(floats)
    in_mirror, *turned, differentiable = plan(mirrored(floats))
    assert bool(differentiable)
    np.testing.assert_allclose(in_mirror, values, rtol=MIRROR)
    for found, expected in zip(turned, map(mirrored, gradients), strict=True):
        size = max(float(jnp.max(jnp.abs(v))) for v in jax.tree.leaves(expected))
        jax.tree.map(
            lambda a, b, size=size: np.testing.assert_allclose(a, b, rtol=0.0, atol=MIRROR * size),
            found,
            expected,
        )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("leaf", "h"),
    [
        (lambda s: s.airframe.body.mass, 1e-5),
        (lambda s: s.cone_angle, 1e-5),
        (lambda s: s.weights.time, 1e-5),
        (lambda s: s.goal.position, 1e-5),
    ],
)
def test_gradients_are_differences_of_plans_made_again(planned, leaf, h):
    floats, plan = planned
    _, *gradients, _ = plan(floats)
    direction = jnp.ones_like(leaf(floats))
    ahead, behind = (plan(eqx.tree_at(leaf, floats, leaf(floats) + t * direction))[0] for t in (h, -h))
    slope = (ahead - behind) / (2.0 * h)
    found = jnp.stack([jnp.vdot(leaf(g), direction) for g in gradients])
    np.testing.assert_allclose(found, slope, rtol=DIFFERENCES, atol=1e-5)


@pytest.mark.nightly
def test_a_lane_without_derivative_says_so_and_harms_no_other():
    """The second vehicle is too heavy for its rotors: its gradient is NaN, and zero where masked."""
    scenario = scenarios.ascent_to_platform()
    planner = jaxscp.Planner(nodes=20)

    def cost(mass):
        solution = planner(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass))
        return solution.cost, solution.differentiable

    def masked(masses):
        costs, good = jax.vmap(cost)(masses)
        return jnp.sum(jnp.where(good, costs, 0.0)), good

    masses = jnp.array([0.928, 40.0, 0.85])
    (_, good), gradient = jax.jit(jax.value_and_grad(masked, has_aux=True))(masses)
    assert not bool(good[1])
    assert np.all(np.isfinite(gradient))
    for lane, defined in enumerate(good):
        assert gradient[lane] > 0.0 if defined else gradient[lane] == 0.0
