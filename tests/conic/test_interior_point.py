"""Interior point: optimal values against CLARABEL, certificates, multipliers, batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import Status, status_names
from jaxscp.conic import export
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.random_programs import random_program
from tests.support.reference import clarabel_optimum

SAME_VALUE = 1e-6  # relative; both stop at a gap of about 1e-8
FEASIBLE = 1e-6  # in each row's own unit
SEEDS = range(12)


@pytest.fixture(
    scope="module", params=[True, pytest.param(False, marks=pytest.mark.slow)], ids=["compiled", "as JAX"]
)
def solve(request):
    return eqx.filter_jit(InteriorPoint(compiled=request.param))


def reference(program) -> tuple[str, float]:
    p = export(program)
    return clarabel_optimum(p.P, p.q, p.A, p.b, (p.zero, p.nonnegative, p.second_order))


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize("seed", SEEDS)
def test_optimal_value_is_clarabels(solve, seed, norm):
    program = random_program(seed, norm=norm)
    status, value = reference(program)
    assert status == "Solved"
    solution = solve(program)
    assert status_names(solution.status) == "converged"
    np.testing.assert_allclose(solution.objective, value, rtol=SAME_VALUE, atol=SAME_VALUE)
    assert float(program.violation(solution.z)) < FEASIBLE


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize("kind", ["infeasible", "unbounded"])
@pytest.mark.parametrize("seed", range(6))
def test_certificates(solve, seed, kind, norm):
    solution = solve(random_program(seed, kind=kind, norm=norm))
    assert status_names(solution.status) == kind
    assert np.all(np.isfinite(solution.z))


def test_multipliers_prove_optimality(solve):
    """The gradient of the Lagrangian vanishes; multipliers are in their cones and complementary to the slacks."""
    program = random_program(3, norm=False)
    solution = solve(program)
    y, z = solution.multipliers, solution.z
    gradient = jnp.einsum("kij,kj->ki", program.hessian, z) + program.gradient
    gradient += program.links.transpose_apply(y.links)
    gradient += jnp.einsum("kln,kl->kn", program.rows.matrix, y.rows)
    gradient += jnp.einsum("kcdn,kcd->kn", program.cones[0].matrix, y.cones[0])
    np.testing.assert_allclose(gradient, 0.0, atol=1e-5)
    slack = program.rows.offset - jnp.einsum("kln,kn->kl", program.rows.matrix, z)
    assert float(jnp.min(y.rows)) >= 0.0
    np.testing.assert_allclose(slack * y.rows, 0.0, atol=1e-5)
    bound = program.links.weight * (1.0 + 1e-6) + 1e-6
    assert np.all(jnp.linalg.norm(program.links.soft * y.links, axis=1) <= bound)


def test_batch_elements_are_independent(solve):
    programs = [random_program(seed) for seed in range(3)]
    batch = jax.tree.map(lambda *v: jnp.stack(v), *programs)
    poisoned = eqx.tree_at(lambda p: p.gradient, batch, batch.gradient.at[1].set(jnp.nan))
    solutions = jax.jit(jax.vmap(InteriorPoint()))(poisoned)
    names = status_names(solutions.status)
    assert list(names) == ["converged", "numerical_error", "converged"]
    for element in (0, 2):
        alone = solve(programs[element])
        np.testing.assert_allclose(solutions.objective[element], alone.objective, rtol=SAME_VALUE)
        np.testing.assert_allclose(solutions.z[element], alone.z, atol=1e-4)


def test_iteration_limit_is_a_status():
    solution = eqx.filter_jit(InteriorPoint(max_iterations=2))(random_program(0))
    assert bool(solution.status == Status.iteration_limit)


def test_derivatives_of_the_iterations_are_refused(solve):
    program = random_program(0)

    def cost(gradient, freeze):
        moved = eqx.tree_at(lambda p: p.gradient, program, gradient)
        return jnp.sum(solve(jax.lax.stop_gradient(moved) if freeze else moved).z)

    with pytest.raises(TypeError, match="ConicLayer"):
        jax.grad(cost)(program.gradient, False)
    with pytest.raises(TypeError, match="ConicLayer"):
        jax.jvp(lambda g: cost(g, False), (program.gradient,), (program.gradient,))
    assert not jnp.any(jax.grad(cost)(program.gradient, True))
