"""Texts of a solution, and the backends that served."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from jax.scipy.special import erf

import jaxscp as js
from jaxscp.backends.libraries import INTEGRATION, INTERIOR_POINT
from tests.support.own_problems import double_integrator, squared_control

ENERGY = js.Cost(running=squared_control)
FIXED = js.Time(5, js.FixedTime(2.0))


@pytest.fixture(scope="module")
def solution():
    problem = double_integrator(ENERGY, FIXED)
    return js.solve(problem, js.straight_line(problem))


def served(solution):
    return solution.backends.report()


def test_it_says_which_backend_served(solution):
    integration, conic = (
        "C++" if library.available() else "JAX" for library in (INTEGRATION, INTERIOR_POINT)
    )
    assert served(solution) == f"integration: {integration}; conic step: {conic}"


def test_an_operation_without_compiled_code_is_served_by_jax_with_a_warning():
    if not INTEGRATION.available():
        pytest.skip("compiled code is not installed")
    dynamics = js.Dynamics.of(lambda x, u, t, p: jnp.array([x[1] + erf(x[1]), u[0]]), states=2, controls=1)
    problem = js.OptimalControlProblem(
        dynamics, ENERGY, js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0])), FIXED
    )
    with pytest.warns(js.PerformanceWarning, match="the operation erf"):
        found = js.solve(problem, js.straight_line(problem))
    assert served(found).startswith("integration: JAX")


def test_the_table_has_a_line_an_iteration_and_one_for_the_optimum(solution):
    lines = solution.iteration_table().splitlines()
    assert len(lines) == 2 + int(solution.iterations)
    assert lines[-1].split() == [
        "optimum",
        f"{float(solution.cost):.4f}",
        "2.000",
        f"{float(solution.certificate.defect):.1e}",
        str(int(solution.interior_point_iterations)),
    ]


def test_its_text_has_status_cost_and_certificate(solution):
    text = str(solution)
    assert text.startswith(f"converged: cost {float(solution.cost):.6g}, final time 2")
    assert solution.certificate.report() in text


def test_the_text_of_a_batch_counts_statuses(solution):
    other = js.Status.infeasible
    batch = jax.tree.map(lambda *v: jnp.stack(v), *[solution] * 3)
    status = jax.vmap(js.Status.where, (0, 0, None))(jnp.array([True, False, True]), batch.status, other)
    text = str(eqx.tree_at(lambda s: s.status, batch, status))
    assert "3 solutions" in text
    assert "2 converged" in text
    assert "1 infeasible: The constraints of a convex subproblem" in text
    with pytest.raises(ValueError, match="a batch has no table"):
        batch.iteration_table()


def test_its_text_under_a_transformation_is_its_structure(solution):
    texts = []
    jax.eval_shape(lambda s: texts.append(str(s)) or s.cost, solution)
    assert texts[0].startswith("Solution(")
    assert str(jax.tree.map(lambda v: None, solution)).startswith("Solution(")
