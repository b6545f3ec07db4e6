"""The method with second derivatives: local optima, checked by IPOPT, and no violation between the nodes."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.rivals.convert import as_arrays
from jaxscp import NewtonSCP, Planner, Status, scenarios, status_names
from jaxscp.backends.xla import compiler_options
from jaxscp.scp.newton import TOLERANCE_FACTORS
from jaxscp.verification.certificate import OPTIMALITY_TOLERANCE
from tests.support.flights import random_nodes, short_problem

MISSIONS = {"platform": scenarios.platform_to_platform, "ascend": scenarios.ascent_to_platform}
# Relative. Many positions of the short intervals are local optima with nearly the same cost. Another start may lead to
# another of them.
SAME_COST = 2e-3


@pytest.mark.nightly
@pytest.mark.parametrize("mission", MISSIONS)
def test_optimal_by_ipopts_account_and_safe_between_nodes(mission):
    optimum = pytest.importorskip("benchmarks.rivals.optimum", reason="needs CasADi")
    planner = Planner()
    for weight in (0.0, 5.0):
        scenario = eqx.tree_at(lambda s: s.weights.time, MISSIONS[mission](), jnp.asarray(weight))
        solution = planner(scenario)
        assert status_names(solution.status) == "converged"
        certificate = solution.certificate
        assert float(certificate.error("final position")) < 1e-3
        assert np.all(certificate.between_nodes <= certificate.allowed)
        assert certificate.passed()
        moving = eqx.tree_at(lambda c: c.optimality, certificate, 2.0 * jnp.asarray(OPTIMALITY_TOLERANCE))
        assert not moving.passed()
        best = optimum.best(optimum.Optimum(as_arrays(scenario, planner.nodes_for(scenario))).solve(starts=1))
        assert abs(float(solution.cost) / best - 1.0) < SAME_COST


@pytest.mark.nightly
def test_batch_elements_end_as_they_do_alone():
    """Three vehicles; the second is too heavy for its rotors."""
    base = scenarios.ascent_to_platform()
    masses = jnp.array([0.928, 40.0, 0.85])
    make = lambda mass: eqx.tree_at(lambda s: s.airframe.body.mass, base, mass)  # noqa: E731
    planner = Planner()
    batch = jax.jit(jax.vmap(planner))(jax.vmap(make)(masses))
    assert list(status_names(batch.status)) == ["converged", "invalid_input", "converged"]
    for i in (0, 2):
        alone = planner(make(masses[i]))
        np.testing.assert_allclose(batch.cost[i], alone.cost, rtol=SAME_COST)
    floats = [np.asarray(leaf) for leaf in jax.tree.leaves(batch) if jnp.issubdtype(leaf.dtype, jnp.inexact)]
    assert all(np.isfinite(leaf[[0, 2]]).all() and np.isnan(leaf[1]).all() for leaf in floats)


def by_forcing(act):
    """``act(NewtonSCP(initial_forcing), *more)`` as a function of ``initial_forcing`` and ``more``; compiled once."""

    def function(initial_forcing, *more):
        return act(eqx.tree_at(lambda method: method.initial_forcing, NewtonSCP(), initial_forcing), *more)

    return jax.jit(function, compiler_options=compiler_options())


@pytest.fixture(scope="module")
def ascent():
    """Problem and guess of Case 2."""
    setup = jax.jit(Planner(nodes=20).pipeline.setup, compiler_options=compiler_options())
    return setup(scenarios.ascent_to_platform())[:2]


@pytest.mark.nightly
def test_coarse_subproblems_lead_to_optima_of_the_same_cost():
    """In fewer conic steps over both cases, though one of them takes a subproblem more."""
    steps = np.zeros(2, int)
    for scenario in (scenarios.platform_to_platform(), scenarios.ascent_to_platform()):
        setup = jax.jit(Planner(nodes=20).pipeline.setup, compiler_options=compiler_options())
        problem, z, *_ = setup(scenario)
        run = by_forcing(lambda method, problem=problem, z=z: method.run(problem, z))
        coarse, exact = run(NewtonSCP().initial_forcing), run(0.0)
        assert bool(coarse.is_optimum)
        assert bool(exact.is_optimum)
        np.testing.assert_allclose(coarse.cost, exact.cost, rtol=SAME_COST)
        steps += [int(state.history.conic_iterations.sum()) for state in (coarse, exact)]
    assert steps[0] < 0.95 * steps[1]


@pytest.mark.slow
def test_no_iterations_end_by_a_coarse_subproblem(ascent):
    """At tolerance 1e9 the subproblem makes no step; this must not count as convergence."""
    problem, z = ascent
    step = by_forcing(lambda method, state: method.step(problem, state, TOLERANCE_FACTORS[0]))
    state = jax.jit(NewtonSCP().init)(problem, z)
    while not bool(state.close_to_optimum):
        state = step(NewtonSCP().initial_forcing, state)
    idle = step(1e9, state)
    assert int(idle.history.conic_iterations[state.iterations]) == 0
    assert not bool(idle.close_to_optimum)
    assert bool(idle.status != Status.converged)


def test_a_problem_that_carries_its_cost_as_a_state_is_refused():
    problem = dataclasses.replace(short_problem(), carries_cost=True)
    z = random_nodes(problem, 0)
    with pytest.raises(ValueError, match="carries_cost"):
        NewtonSCP().init(problem, z)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [6, 93, 1010, 1018])
def test_plans_with_a_flat_mesh_are_optima(seed):
    """On a free mesh, the interior point ends without an optimum after 80 steps, far along the mesh."""
    from benchmarks.robustness.chains import chain

    solution = Planner()(chain(seed).scenario)
    assert status_names(solution.status) == "converged"
    assert bool(solution.differentiable)
    assert float(solution.certificate.optimality) < 1e-4
