"""The quadratic form against what it promises, and OSQP on it: values, statuses, jit, vmap, and inside SCP."""

import clarabel
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import PTR, ProximalTrustRegion, status_names
from jaxscp.cones.cone import NonNegative
from jaxscp.conic import OSQP, Cones
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.quadratic import DEFAULT_FACETS, quadratic_form
from jaxscp.conic.random_programs import random_program, smallest_program
from jaxscp.dynamics.double_integrator import DoubleIntegrator
from jaxscp.landing.constraints import Limits, within_control_limits
from jaxscp.problem.constraint import Constraint, repeat_over_nodes
from jaxscp.problem.problem import Boundary, FixedComponents, OptimalControlProblem, fixed_components

SAME_VALUE = 1e-3  # relative; an operator-splitting method at a tolerance of 1e-5
ROUNDING = 1e-10
SEEDS = range(6)


@pytest.fixture(scope="module")
def solve():
    return eqx.filter_jit(OSQP())


def reference(form) -> tuple[str, float]:
    equalities = form.hard.offset.size
    kinds = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(form.u.size - equalities)]
    options = clarabel.DefaultSettings()
    options.verbose = False
    answer = clarabel.DefaultSolver(form.P, form.q, form.A, form.u, kinds, options).solve()
    return str(answer.status), answer.obj_val + form.constant


# --- the quadratic form ---


def random_point(program, seed):
    return jnp.asarray(np.random.default_rng(seed).standard_normal(program.gradient.shape))


def lifted(form, z):
    """All variables of the form at a point, absolute values as small as they may be."""
    deviation = (np.asarray(z) - form.centre).ravel()
    own = np.zeros(form.q.size - deviation.size)
    x = np.concatenate([deviation, own])
    slack = form.u - form.A @ x  # a row -v - a <= 0 or v - a <= 0 lacks |v| where v is on its wrong side
    for column in range(deviation.size, form.q.size):
        rows = form.A[:, [column]].nonzero()[0]
        rows = rows[form.A[rows, column].toarray().ravel() < 0]
        x[column] = max(0.0, -slack[rows].min())
    return x


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
def test_cost_is_the_one_norms(norm):
    program = random_program(0, norm=norm)
    form, z = quadratic_form(program), random_point(program, 1)
    expected = jnp.vdot(program.gradient, z) + 0.5 * jnp.einsum("ki,kij,kj->", z, program.hessian, z)
    expected += jnp.sum(program.links.weight[:, None] * jnp.abs(program.virtual_control(z)))
    if norm:
        step = program.norm.scale * (z - program.norm.centre)
        expected += jnp.sum(program.norm.weight[:, None] * jnp.abs(step))
    np.testing.assert_allclose(form.objective(lifted(form, z)), expected, rtol=ROUNDING)
    assert float(expected) >= float(program.objective(z))  # an upper bound of the Euclidean cost


@pytest.mark.parametrize(("dimension", "exact"), [(2, True), (3, False), (4, False)])
def test_cones_are_approximated_from_inside(dimension, exact):
    """What the form allows the cone allows; close to its axis the form allows everything."""
    base = random_program(1, nodes=3, variables=4)
    matrix = -jnp.broadcast_to(jnp.eye(4)[:dimension], (3, 1, dimension, 4))
    program = eqx.tree_at(lambda p: p.cones, base, (Cones(matrix, jnp.zeros((3, 1, dimension))),))
    form = quadratic_form(program, facets=8)
    cone_rows = slice(
        form.hard.offset.size + form.blocks[0].mix.shape[0],
        form.hard.offset.size + sum(block.mix.shape[0] for block in form.blocks[:-2]),
    )
    random = np.random.default_rng(2)
    inner = {3: np.cos(np.pi / 8), 4: 1.0 / np.sqrt(3.0)}.get(dimension, 1.0)
    for _ in range(50):
        z = random.standard_normal((3, 4))
        z[:, 0] = np.abs(z[:, 0])
        radius = np.linalg.norm(z[:, 1:dimension], axis=1)
        x = lifted(form, z)
        allowed = np.all((form.A @ x - form.u)[cone_rows] <= ROUNDING)
        if allowed:
            assert np.all(radius <= z[:, 0] + ROUNDING)
        if np.all(radius <= inner * z[:, 0]):
            assert allowed
        if exact:
            assert allowed == np.all(radius <= z[:, 0])


def test_more_facets_come_closer():
    program = random_program(3)
    values = [reference(quadratic_form(program, facets))[1] for facets in (4, 8, 16, 64)]
    exact = quadratic_form(eqx.tree_at(lambda p: p.cones, program, ()))  # a bound from below: no cones
    assert values == sorted(values, reverse=True)
    assert values[-1] >= reference(exact)[1] - 1e-7


# --- OSQP ---


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize("seed", SEEDS)
def test_optimal_value_of_the_form_is_clarabels(seed, norm):
    form, answer = OSQP().solve_quadratic(random_program(seed, norm=norm))
    status, value = reference(form)
    assert status == "Solved"
    np.testing.assert_allclose(answer.objective, value, rtol=SAME_VALUE)


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize("kind", ["infeasible", "unbounded"])
def test_statuses(solve, kind, norm):
    solution = solve(random_program(0, kind=kind, norm=norm))
    assert status_names(solution.status) == kind
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((solution.z, solution.multipliers)))


def test_iteration_limit_is_a_status():
    solution = OSQP(max_iterations=2, polish=False)(random_program(0))
    assert status_names(solution.status) == "iteration_limit"
    assert int(solution.iterations) == 2


def test_smallest_program(solve):
    """Least force from 0 to 1 in one step: u = 1, cost 1/2, and the price of distance is -u."""
    solution = solve(smallest_program())
    assert status_names(solution.status) == "converged"
    np.testing.assert_allclose(solution.z, [[0.0, 1.0], [1.0, 0.0]], atol=1e-4)
    np.testing.assert_allclose(solution.objective, 0.5, atol=1e-4)
    np.testing.assert_allclose(np.abs(solution.multipliers.links.ravel()), 1.0, atol=1e-3)


def test_multipliers_balance_the_cost(solve):
    """Where no norm but the cones' acts, they are the given program's: the Lagrangian is stationary."""
    program = random_program(4, norm=False)
    z = (solution := solve(program)).z
    y = solution.multipliers
    gradient = program.gradient + jnp.einsum("kij,kj->ki", program.hessian, z)
    gradient += program.links.transpose_apply(y.links)
    gradient += jnp.einsum("krn,kr->kn", program.rows.matrix, y.rows)
    gradient += jnp.einsum("kcdn,kcd->kn", program.cones[0].matrix, y.cones[0])
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)
    assert float(y.rows.min()) > -1e-3
    # A pyramid inside the cone has a dual that holds the cone's dual: the multipliers may lean out by this much.
    lean = 1.0 / np.cos(np.pi / DEFAULT_FACETS)
    tail = jnp.linalg.norm(y.cones[0][..., 1:], axis=-1)
    assert float(jnp.max(tail - lean * y.cones[0][..., 0])) < 1e-3


def test_objective_is_the_given_programs_cost(solve):
    program = random_program(5)
    solution = solve(program)
    np.testing.assert_allclose(solution.objective, program.objective(solution.z), rtol=ROUNDING)
    best = eqx.filter_jit(InteriorPoint())(program).objective
    assert float(best) <= float(solution.objective) + 1e-3


def test_lanes_of_a_batch_do_not_touch_each_other(solve):
    programs = [random_program(seed) for seed in range(3)]
    programs[1] = eqx.tree_at(lambda p: p.gradient, programs[1], jnp.full_like(programs[1].gradient, jnp.nan))
    batch = jax.vmap(OSQP())(jax.tree.map(lambda *leaves: jnp.stack(leaves), *programs))
    assert list(status_names(batch.status)) == ["converged", "numerical_error", "converged"]
    assert np.all(np.isfinite(batch.z))
    for lane in (0, 2):
        np.testing.assert_allclose(batch.z[lane], solve(programs[lane]).z, atol=ROUNDING)


# --- inside the method ---

NODES = 9


def least_effort(state, control, weights):
    return jnp.sum(control * control)


def price_of_time(state, time, weights):
    return 5.0 * time


@pytest.fixture(scope="module")
def double_integrator():
    """One metre from rest to rest, effort against time, and a straight guess."""
    ends = [FixedComponents(jnp.array([x, 0.0]), jnp.ones(2)) for x in (0.0, 1.0)]
    limits = repeat_over_nodes(Limits(jnp.array([-2.0]), jnp.array([2.0])), NODES)
    problem = OptimalControlProblem(
        dynamics=DoubleIntegrator(1),
        running_cost=least_effort,
        terminal_cost=price_of_time,
        weights=(),
        constraints=(
            Constraint(within_control_limits, limits, NonNegative(), jnp.ones(NODES, bool), "acceleration"),
        ),
        initial=Boundary(fixed_components, ends[0]),
        final=Boundary(fixed_components, ends[1]),
        dilation_min=jnp.asarray(0.1),
        dilation_max=jnp.asarray(10.0),
        nodes=NODES,
    )
    states = jnp.stack([jnp.linspace(0.0, 1.0, NODES), jnp.full(NODES, 0.5)], axis=1)
    return problem, problem.join(states, jnp.zeros((NODES, 1)), jnp.full(NODES, 2.0))


def test_the_method_runs_on_it(double_integrator):
    """Iterates on OSQP are those on the interior point, as far as the 1-norm of virtual control is unused."""
    histories = []
    for conic in (InteriorPoint(), OSQP()):
        method = PTR(trust_region=ProximalTrustRegion(1.0), max_iterations=8, coarsest=0.0, conic=conic)
        result = jax.jit(method.run)(*double_integrator)
        histories.append(result.history)
        assert float(result.history.virtual[-1]) < 1e-4
    np.testing.assert_allclose(histories[1].cost, histories[0].cost, rtol=SAME_VALUE)
    np.testing.assert_allclose(histories[1].final_time, histories[0].final_time, rtol=1e-2)
