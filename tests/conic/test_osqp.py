"""OSQP on the quadratic form: optimal values, statuses, jit, vmap, and inside PTR."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import PTR, ProximalTrustRegion, status_names
from jaxscp.conic import OSQP
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.quadratic import DEFAULT_FACETS
from jaxscp.conic.random_programs import random_program, smallest_program
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from tests.support.reference import clarabel_optimum

SAME_VALUE = 1e-3  # relative; an operator-splitting method at a tolerance of 1e-5
ROUNDING = 1e-10
SEEDS = range(6)


@pytest.fixture(scope="module")
def solve():
    return eqx.filter_jit(OSQP())


def reference(form) -> tuple[str, float]:
    equalities = form.equalities.offset.size
    sizes = (equalities, form.u.size - equalities, ())
    status, value = clarabel_optimum(form.P, form.q, form.A, form.u, sizes)
    return status, value + form.constant


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
    """Least force from 0 to 1 in one step: u = 1, cost 1/2, multiplier of the distance -u."""
    solution = solve(smallest_program())
    assert status_names(solution.status) == "converged"
    np.testing.assert_allclose(solution.z, [[0.0, 1.0], [1.0, 0.0]], atol=1e-4)
    np.testing.assert_allclose(solution.objective, 0.5, atol=1e-4)
    np.testing.assert_allclose(np.abs(solution.multipliers.links.ravel()), 1.0, atol=1e-3)


def test_multipliers_balance_the_cost(solve):
    """With no active norm but the cones', they equal the given program's: the Lagrangian is stationary."""
    program = random_program(4, norm=False)
    z = (solution := solve(program)).z
    y = solution.multipliers
    gradient = program.gradient + jnp.einsum("kij,kj->ki", program.hessian, z)
    gradient += program.links.transpose_apply(y.links)
    gradient += jnp.einsum("krn,kr->kn", program.rows.matrix, y.rows)
    gradient += jnp.einsum("kcdn,kcd->kn", program.cones[0].matrix, y.cones[0])
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)
    assert float(y.rows.min()) > -1e-3
    # The dual of a pyramid inside the cone contains the cone's dual, and exceeds it by this factor.
    lean = 1.0 / np.cos(np.pi / DEFAULT_FACETS)
    tail = jnp.linalg.norm(y.cones[0][..., 1:], axis=-1)
    assert float(jnp.max(tail - lean * y.cones[0][..., 0])) < 1e-3


def test_objective_is_the_given_programs_cost(solve):
    program = random_program(5)
    solution = solve(program)
    np.testing.assert_allclose(solution.objective, program.objective(solution.z), rtol=ROUNDING)
    best = eqx.filter_jit(InteriorPoint())(program).objective
    assert float(best) <= float(solution.objective) + 1e-3


def test_batch_elements_are_independent(solve):
    programs = [random_program(seed) for seed in range(3)]
    programs[1] = eqx.tree_at(lambda p: p.gradient, programs[1], jnp.full_like(programs[1].gradient, jnp.nan))
    batch = jax.vmap(OSQP())(jax.tree.map(lambda *leaves: jnp.stack(leaves), *programs))
    assert list(status_names(batch.status)) == ["converged", "numerical_error", "converged"]
    assert np.all(np.isfinite(batch.z))
    for element in (0, 2):
        np.testing.assert_allclose(batch.z[element], solve(programs[element]).z, atol=ROUNDING)


# --- inside the method ---

NODES = 9


@pytest.fixture(scope="module")
def double_integrator():
    """One metre from rest to rest, effort against time, and a straight guess."""
    asked = jaxscp.OptimalControlProblem(
        dynamics=jaxscp.DoubleIntegrator(1),
        cost=jaxscp.Cost(running=lambda x, u, t, p: u @ u, terminal=lambda x, t, p: 5.0 * t),
        boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([1.0, 0.0])),
        time=jaxscp.Time(NODES, jaxscp.FreeTime(0.1, 10.0), mesh_weight=None),
        constraints=(jaxscp.bounds(control=(-2.0, 2.0)),),
    )
    problem = over_scaled_time(canonical(asked), Continuous())
    states = jnp.stack([jnp.linspace(0.0, 1.0, NODES), jnp.full(NODES, 0.5)], axis=1)
    return problem, problem.join(states, jnp.zeros((NODES, 1)), jnp.full(NODES, 2.0))


def test_the_method_runs_on_it(double_integrator):
    """Iterates agree with the interior point's if virtual control is not used, whose norm differs."""
    histories = []
    for conic in (InteriorPoint(), OSQP()):
        method = PTR(
            trust_region=ProximalTrustRegion(1.0), max_iterations=8, initial_forcing=0.0, conic=conic
        )
        result = jax.jit(method.run)(*double_integrator)
        histories.append(result.history)
        assert float(result.history.virtual_control[-1]) < 1e-4
    np.testing.assert_allclose(histories[1].cost, histories[0].cost, rtol=SAME_VALUE)
    np.testing.assert_allclose(histories[1].final_time, histories[0].final_time, rtol=1e-2)
