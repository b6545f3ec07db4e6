"""Warm start of the interior point: fewer steps, same solution; and the starting point against its definition."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import status_names
from jaxscp.cones import product
from jaxscp.conic import conic_form
from jaxscp.conic.equilibrate import equilibrate
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, WarmStart
from jaxscp.conic.random_programs import random_program
from jaxscp.conic.warm_start import AT_BOUND, HIGHEST_MU, LOWEST_MU, RELAXATION, central_start
from jaxscp.core.trees import tree_axpy, tree_dot, tree_max

SAME_COST = 1e-6  # relative; both solutions are as accurate as the solver's tolerance
ROUNDING = 1e-9  # relative, as for the loop from a cold start
STEPS = 3


@pytest.fixture(
    scope="module",
    params=[pytest.param(True, id="compiled"), pytest.param(False, id="JAX", marks=pytest.mark.nightly)],
)
def solvers(request):
    """Solvers (program) -> solution with a cold start, and (program, warm start) -> solution."""
    solver = InteriorPoint(compiled=request.param)
    return eqx.filter_jit(solver), eqx.filter_jit(lambda program, warm: solver(program, 0.0, warm))


def warm_start_from(solution) -> WarmStart:
    return WarmStart(solution.z, solution.multipliers)


def perturbed(program, size: float):
    """Program with other data, as the next subproblem has."""
    key = jax.random.key(7)
    return eqx.tree_at(
        lambda p: (p.gradient, p.rows.offset),
        program,
        (
            program.gradient + size * jax.random.normal(key, program.gradient.shape),
            program.rows.offset + size * jax.random.uniform(key, program.rows.offset.shape),
        ),
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_good_warm_start_saves_steps(solvers, seed):
    cold, warm = solvers
    before = random_program(seed, norm=False)  # a warm start has no multipliers of a norm's cost
    program = perturbed(before, 1e-3)
    expected = cold(program)
    found = warm(program, warm_start_from(cold(before)))
    assert status_names(found.status) == status_names(expected.status) == "converged"
    assert int(found.iterations) <= int(expected.iterations) - 2
    np.testing.assert_allclose(found.objective, expected.objective, rtol=SAME_COST)


@pytest.mark.parametrize(
    "defect", ["far", "NaN", *(pytest.param(d, marks=pytest.mark.nightly) for d in ("wrong signs", "zeros"))]
)
@pytest.mark.parametrize("kind", ["feasible", "infeasible", "unbounded"])
def test_a_useless_warm_start_does_no_harm(solvers, kind, defect):
    cold, warm = solvers
    program = random_program(1, kind=kind)
    zeros = WarmStart(jnp.zeros_like(program.gradient), ConicMultipliers.zeros(program))
    noise = lambda v: 1e3 * jax.random.normal(jax.random.key(v.size), v.shape)  # noqa: E731
    useless = {
        "far": lambda: jax.tree.map(noise, (zeros.z, zeros.multipliers)),
        "NaN": lambda: (zeros.z * jnp.nan, zeros.multipliers),
        "wrong signs": lambda: (zeros.z, jax.tree.map(lambda v: v - 10.0, zeros.multipliers)),
        "zeros": lambda: (zeros.z, zeros.multipliers),
    }[defect]()
    expected, found = cold(program), warm(program, WarmStart(*useless))
    assert status_names(found.status) == status_names(expected.status)
    assert bool(jnp.all(jnp.isfinite(found.z)))
    if kind == "feasible":
        np.testing.assert_allclose(found.objective, expected.objective, rtol=SAME_COST)


def test_without_an_estimate_the_start_is_cold(solvers):
    cold, warm = solvers
    program = random_program(2)
    none = WarmStart(program.gradient, ConicMultipliers.zeros(program), available=jnp.zeros((), bool))
    expected, found = cold(program), warm(program, none)
    assert int(found.iterations) == int(expected.iterations)
    np.testing.assert_array_equal(found.z, expected.z)


def test_each_batch_element_has_its_own_warm_start():
    programs = [random_program(seed) for seed in range(3)]
    solver = jax.jit(InteriorPoint().__call__)
    starts = [warm_start_from(solver(p)) for p in programs]
    starts[1] = eqx.tree_at(lambda w: w.z, starts[1], starts[1].z * jnp.nan)
    starts = [WarmStart(w.z, w.multipliers, jnp.ones((), bool)) for w in starts]
    single = jax.jit(lambda p, w: InteriorPoint()(p, 0.0, w))
    stacked = jax.tree.map(lambda *v: jnp.stack(v), *zip(programs, starts, strict=True))
    batch = jax.jit(jax.vmap(lambda p, w: InteriorPoint()(p, 0.0, w)))(*stacked)
    for element, alone in enumerate(map(single, programs, starts)):
        np.testing.assert_array_equal(batch.z[element], alone.z)
        assert int(batch.iterations[element]) == int(alone.iterations)


@pytest.mark.nightly
@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
def test_the_compiled_loop_starts_as_jax_does(norm):
    program = random_program(4, norm=norm)
    solution = jax.jit(InteriorPoint().__call__)(perturbed(program, 0.1))
    ours, jaxs = (
        jax.jit(lambda p, w, c=c: InteriorPoint(max_iterations=STEPS, compiled=c).iterate(p, None, w))(
            program, warm_start_from(solution)
        )
        for c in (True, False)
    )
    assert int(ours.iterations) == int(jaxs.iterations)
    for one, other in zip(jax.tree.leaves(ours.iterate), jax.tree.leaves(jaxs.iterate), strict=True):
        size = max(1.0, float(jnp.max(jnp.abs(other), initial=0.0)))
        np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING * size)


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.slow
def test_the_start_is_on_the_central_path_with_the_same_difference(norm):
    """The pair is central, s o y = mu e, and s - y is the warm start's, except in relaxed bounds."""
    program, _ = equilibrate(random_program(0, norm=norm))
    key = jax.random.key(0)
    warm_start = WarmStart(
        program.gradient,
        jax.tree.map(lambda v: jax.random.normal(key, v.shape), ConicMultipliers.zeros(program)),
    )
    x, y, s = central_start(program, warm_start)
    mu = float(s.orthant[0, 0] * y.orthant[0, 0])
    assert LOWEST_MU <= mu <= HIGHEST_MU
    np.testing.assert_array_equal(x.z, warm_start.z)
    trust, _ = conic_form.norm_slices(program)
    relaxation = RELAXATION * mu / y.second[trust, 0]
    s = eqx.tree_at(lambda v: v.second, s, s.second.at[trust, 0].add(-relaxation))
    identity, complementarity = product.identity(s), product.product(s, y)
    np.testing.assert_allclose(complementarity.orthant, mu * identity.orthant, rtol=ROUNDING)
    np.testing.assert_allclose(complementarity.second, mu * identity.second, atol=ROUNDING)
    hard = 1.0 - program.links.soft
    np.testing.assert_array_equal(y.zero, hard * warm_start.multipliers.links)
    slack = conic_form.constraint_offset(program).orthant - conic_form.times_constraints(program, x).orthant
    np.testing.assert_allclose(s.orthant - y.orthant, slack - warm_start.multipliers.rows, atol=ROUNDING)


@pytest.mark.parametrize("fraction", [0.9, 1.1])
def test_virtual_control_starts_at_its_value_only_at_the_bound(fraction):
    """Elsewhere a solution has no virtual control: the steps remove the residual of the soft rows."""
    program, _ = equilibrate(random_program(0))
    warm_start = WarmStart(program.gradient, ConicMultipliers.zeros(program))
    soft, weight = program.links.soft, program.links.weight
    sizes = np.where(np.arange(len(weight)) == 1, fraction * AT_BOUND, 0.5) * weight
    links = sizes[:, None] * soft / jnp.sqrt(jnp.maximum(1.0, jnp.sum(soft, axis=1, keepdims=True)))
    warm_start = eqx.tree_at(lambda w: w.multipliers.links, warm_start, links)
    x, _, _ = central_start(program, warm_start)
    virtual = np.linalg.norm(program.virtual_control(warm_start.z), axis=1)
    assert np.min(virtual[1:3]) > 0.0
    np.testing.assert_allclose(x.zeta[1], virtual[1] if fraction > 1.0 else 0.0)
    np.testing.assert_array_equal(np.delete(x.zeta, 1), 0.0)


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize(
    "compiled",
    [pytest.param(True, id="compiled"), pytest.param(False, id="JAX", marks=pytest.mark.nightly)],
)
def test_the_final_error_is_computed_not_predicted(compiled, norm):
    """Residuals are predicted far from the end; the error of a result must be exact."""
    program = random_program(3, norm=norm)
    warm_start = WarmStart(jnp.zeros_like(program.gradient), ConicMultipliers.zeros(program))
    loop = jax.jit(InteriorPoint(compiled=compiled).iterate)
    for tolerance in (1e-2, 1e-6):
        assert_exact_error(program, loop(program, jnp.asarray(tolerance), warm_start), tolerance)


def assert_exact_error(given, result, tolerance: float):
    """Assert that the result's error equals its definition and is below the tolerance."""
    program, scales = equilibrate(given)
    x, y, s = result.iterate.x, result.iterate.y, result.iterate.s
    q, b = conic_form.linear_cost(program), conic_form.constraint_offset(program)
    hessian_x = conic_form.times_hessian(program, x)
    dual = tree_axpy(1.0, conic_form.times_constraints_transpose(program, y), tree_axpy(1.0, hessian_x, q))
    primal = tree_axpy(1.0, conic_form.times_constraints(program, x), tree_axpy(-1.0, b, s))
    half = 0.5 * tree_dot(x, hessian_x)
    cost, bound = half + tree_dot(q, x), -half - tree_dot(b, y)
    gap = jnp.abs(cost - bound) / jnp.maximum(scales.cost, jnp.minimum(jnp.abs(cost), jnp.abs(bound)))
    residuals = [tree_max(v) / jnp.maximum(1.0, tree_max(of)) for v, of in ((primal, b), (dual, q))]
    np.testing.assert_allclose(result.iterate.tau, 1.0)
    np.testing.assert_allclose(result.error, jnp.max(jnp.stack([gap, *residuals])), rtol=1e-6, atol=1e-12)
    assert float(result.error) <= tolerance
