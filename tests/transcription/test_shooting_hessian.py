"""Second derivatives of intervals by one integration, compared with automatic differentiation of the whole."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends.xla import compiler_options
from jaxscp.transcription.lagrangian import no_multipliers
from jaxscp.transcription.layout import interval_variables
from jaxscp.transcription.shooting import Grid, evaluate, linearise, linearise_with_hessian
from tests.support.flights import random_nodes, short_problem

ROUNDING = 1e-10


@pytest.mark.parametrize(
    "grid",
    [
        pytest.param(Grid(), id="default", marks=pytest.mark.nightly),
        pytest.param(Grid(subintervals=3, steps=2), id="coarse", marks=pytest.mark.slow),
    ],
)
def test_it_is_what_automatic_differentiation_says(grid):
    problem, random = short_problem(), np.random.default_rng(0)
    z = random_nodes(problem, 1)
    zeros = no_multipliers(problem, z, grid)
    y = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), zeros)

    def lagrangian(z):
        out = evaluate(problem, z, grid)
        total = jnp.sum(out.cost) + jnp.vdot(y.flow, out.end)
        for c, multiplier, v in zip(problem.constraints, y.by_interval(), out.values, strict=True):
            total -= jnp.sum(jnp.where(c.active_in_intervals(v.shape[1])[:, :, None], multiplier * v, 0.0))
        return total

    @functools.partial(jax.jit, compiler_options=compiler_options())
    def along(d):
        """Product of the second derivatives with a direction."""
        return jax.jvp(jax.grad(lagrangian), (z,), (d,))[1]

    second_order = jax.jit(
        lambda z: linearise_with_hessian(problem, z, y, grid), compiler_options=compiler_options()
    )
    linear, curvature = second_order(z)
    for _ in range(3):
        d, e = (jnp.asarray(random.standard_normal(z.shape)) for _ in range(2))
        v, w = interval_variables(problem, d), interval_variables(problem, e)
        expected = jnp.vdot(e, along(d))
        np.testing.assert_allclose(jnp.einsum("iw,iwv,iv->", w, curvature, v), expected, rtol=ROUNDING)
    plain = jax.jit(lambda z: linearise(problem, z, grid))(z)
    for a, b in zip(jax.tree.leaves(linear), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(a, b, rtol=ROUNDING, atol=ROUNDING)
