"""A re-plan is never worse than a plan: which of two solutions is taken."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.core.status import Status
from jaxscp.solver.fallback import better


@pytest.fixture(scope="module")
def plan():
    """One subproblem of the paper's method: the shortest compilation."""
    planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))
    return planner(jaxscp.scenarios.ascent_to_platform())


def ended(plan, status, cost):
    return eqx.tree_at(lambda s: (s.status, s.cost), plan, (status, jnp.asarray(cost)))


def test_where_the_replan_converged_nothing_else_is_made(plan):
    for status in (Status.converged, Status.invalid_input):
        found = ended(plan, status, 2.0)
        assert better(found, lambda needed: pytest.fail("the other plan is not needed")) is found


def test_the_other_one_is_taken_where_it_alone_converged(plan):
    found = better(ended(plan, Status.dynamics_unmet, 1.0), lambda needed: ended(plan, Status.converged, 2.0))
    assert jaxscp.status_names(found.status) == "converged"
    assert (float(found.cost), bool(found.fell_back)) == (2.0, True)
    assert "planned anew" in found.report()


def test_where_neither_converged_the_replan_is_returned(plan):
    found = better(
        ended(plan, Status.dynamics_unmet, 1.0), lambda needed: ended(plan, Status.iteration_limit, 2.0)
    )
    assert jaxscp.status_names(found.status) == "dynamics_unmet"
    assert (float(found.cost), bool(found.fell_back)) == (1.0, False)
    assert "planned anew" not in found.report()


def test_elements_of_a_batch_choose_by_themselves(plan):
    ends = Status.converged, Status.dynamics_unmet
    found = [ended(plan, status, 1.0) for status in ends]
    batch = jax.tree.map(lambda *v: jnp.stack(v), *found)
    chosen = jax.vmap(lambda s: better(s, lambda needed: ended(plan, Status.converged, 2.0)))(batch)
    np.testing.assert_array_equal(chosen.cost, [1.0, 2.0])
    np.testing.assert_array_equal(chosen.fell_back, [False, True])
