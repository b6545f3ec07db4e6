"""Paper mode compared with the published stack (CVXPY, CLARABEL, Numba), subproblem by subproblem."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest

pytest.importorskip("cvxpy", reason="the published stack needs the benchmarks extra: cvxpy")
pytest.importorskip("numba", reason="the published stack needs the benchmarks extra: numba")
paper = pytest.importorskip("benchmarks.rivals.paper", reason="benchmarks/ is not part of this installation")

from benchmarks.rivals.convert import as_arrays, as_method, as_problem  # noqa: E402
from benchmarks.rivals.problem import three_box  # noqa: E402
from jaxscp import PTR, NormTrustRegion, Planner, Status, scenarios, status_names  # noqa: E402

# Both stacks solve their subproblems to about 1e-8. Near a flat optimum such solutions may lie far apart; after
# several subproblems, costs differ by a measured 1e-7.
SAME_COST = 1e-4
SAME_TIME = 1e-4

CASES = {
    "platform to platform": lambda: as_arrays(scenarios.platform_to_platform(), 30),
    "ascent to platform": lambda: as_arrays(scenarios.ascent_to_platform(), 30),
    "three boxes": three_box,
}

COARSE = 1e-3  # relative: costs at the stops with coarse and with exact subproblems, neither optimal
GRIDS = 0.05  # relative: costs at the stops on 30 and on 90 nodes, neither optimal


def with_common_settings(arrays):
    """The case with common settings, so that all cases share one compilation."""
    return replace(arrays, tolerance_virtual=1e-3, tolerance_trust=1e-2, max_iterations=20)


@pytest.fixture(scope="module")
def both():
    """A function: name of a case to the runs of jaxscp and of the published stack, same accuracy."""
    ours = jax.jit(replace(as_method(with_common_settings(three_box())), initial_forcing=0.0).run)

    @cache
    def solve(case):
        arrays = with_common_settings(CASES[case]())
        return ours(*as_problem(arrays)), paper.solve(arrays)

    return solve


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_iterate_costs_the_same(both, case):
    ours, theirs = both(case)
    count = len(theirs.iterations)
    assert theirs.converged
    assert bool(ours.status == Status.converged)
    assert int(ours.iterations) == count
    expected = [record.cost for record in theirs.iterations]
    np.testing.assert_allclose(ours.history.cost[:count], expected, rtol=SAME_COST)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_iterate_takes_the_same_time(both, case):
    ours, theirs = both(case)
    expected = [record.final_time for record in theirs.iterations]
    np.testing.assert_allclose(ours.history.final_time[: len(expected)], expected, rtol=SAME_TIME)


@pytest.mark.slow
def test_three_boxes_stop_where_the_published_stack_is_known_to(both):
    ours, _ = both("three boxes")
    assert int(ours.iterations) == 4
    np.testing.assert_allclose(ours.cost, 27.71, atol=0.005)
    np.testing.assert_allclose(ours.history.final_time[3], 5.91, atol=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_arrays_survive_the_way_there(both, case):
    """The converted problem has the rival's guess, and the same effort and time along this guess."""
    arrays = CASES[case]()
    _, z = as_problem(arrays)
    _, theirs = both(case)
    np.testing.assert_array_equal(z[:, :13], arrays.states)
    np.testing.assert_array_equal(z[:, 15:19], arrays.controls)
    np.testing.assert_allclose(z[:, 13:15], theirs.history[0].elapsed, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("mission", [scenarios.platform_to_platform, scenarios.ascent_to_platform])
def test_coarse_subproblems_lead_to_the_same_stop(mission):
    coarse, exact = (
        Planner(nodes=30, method=method)(mission()) for method in (PTR(), PTR(initial_forcing=0.0))
    )
    assert status_names(coarse.status) == status_names(exact.status) == "converged"
    assert int(coarse.iterations) <= int(exact.iterations) + 1
    steps = [int(s.history.conic_iterations.sum()) for s in (coarse, exact)]
    assert steps[0] < 0.8 * steps[1]
    np.testing.assert_allclose(coarse.cost, exact.cost, rtol=COARSE)


def test_no_iterations_end_by_a_coarse_subproblem():
    """At a tolerance that the reference meets, the step is zero; this must not count as convergence."""
    problem, z = as_problem(with_common_settings(three_box()))
    method = replace(as_method(with_common_settings(three_box())), initial_forcing=1e9)
    assert method.forcing_term(method.init(problem, z)) == 1e9
    state = jax.jit(method.run)(problem, z)
    assert state.history.conic_iterations[0] == 0
    assert int(state.iterations) > 1
    assert bool(state.status == Status.converged)


@pytest.mark.slow
def test_virtual_control_that_stays_ends_the_iterations():
    """On a fine grid, a large trust-region weight stops the iterates before the dynamics hold."""
    found = Planner(nodes=60, method=PTR(NormTrustRegion(20.0)))(scenarios.platform_to_platform())
    assert status_names(found.status) == "dynamics_unmet"
    count = int(found.iterations)
    history = found.history
    virtual_control, step_norm = (np.asarray(v)[:count] for v in (history.virtual_control, history.step_norm))
    settings = PTR()
    assert virtual_control[-1] > settings.tolerance_virtual
    assert step_norm[-1] < settings.tolerance_step < step_norm[-2]
    np.testing.assert_allclose(virtual_control[-1], virtual_control[-2], rtol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("mission", [scenarios.platform_to_platform, scenarios.ascent_to_platform])
def test_a_finer_grid_is_planned_as_well(mission):
    """The trust region penalises the step of the whole trajectory, whatever the number of nodes."""
    coarse, fine = (Planner(nodes=nodes, method=PTR())(mission()) for nodes in (30, 90))
    assert status_names(fine.status) == "converged"
    assert int(fine.iterations) <= int(coarse.iterations) + 2
    np.testing.assert_allclose(fine.cost, coarse.cost, rtol=GRIDS)
