"""The best of a batch with invalid elements, whose numbers and derivatives are NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from tests.support.rooms import put, room

PLANNER = jaxscp.Planner(nodes=12)


@pytest.mark.nightly
@pytest.mark.slow
def test_invalid_elements_are_nan_and_never_the_best():
    def plan(mass):
        found = PLANNER(put(room(), lambda s: s.airframe.body.mass, mass))
        return found.cost, found

    masses = jnp.array([jnp.nan, 5.0, 0.9, 1.1])  # the second is too heavy
    (_, plans), slopes = jax.vmap(jax.value_and_grad(plan, has_aux=True))(masses)
    assert list(jaxscp.status_names(plans.status)) == [
        "invalid_input",
        "invalid_input",
        "converged",
        "converged",
    ]
    for leaf in (*jax.tree.leaves(plans), slopes):
        if jnp.issubdtype(leaf.dtype, jnp.inexact):
            assert np.isnan(leaf[:2]).all()
            assert np.isfinite(leaf[2:]).all()
    np.testing.assert_array_equal(jaxscp.best(plans).cost, plans.cost[2:].min())
