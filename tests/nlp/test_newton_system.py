"""The Newton system, against automatic differentiation of the optimality conditions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from jaxscp.linalg import riccati
from jaxscp.nlp import sensitivity
from jaxscp.nlp.central_path import Point, conditions
from jaxscp.nlp.newton_system import scaled
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.transcription.lagrangian import no_multipliers
from tests.support.own_problems import double_integrator

ROUNDING = 1e-9  # relative to the largest entry
NODES = 5
GRID = js.NewtonSCP().grid


def in_band(x, u, t, p):
    """Curved in state and control."""
    return (2.0 - (x[0] - 0.3) ** 2 - 0.1 * u[0] ** 2)[None]


@pytest.mark.parametrize(
    "where",
    [pytest.param(js.AtNodes(), marks=pytest.mark.slow), js.Throughout()],
    ids=["at nodes", "throughout"],
)
def test_the_matrix_is_the_derivative_of_the_conditions(where):
    """At any point with multipliers inside their cones; also where a constraint holds at some nodes alone."""
    active = np.array([False, True, True, False, True])
    band = js.Constraint(in_band, js.NonNegative(), active=active, where=where, name="band")
    cost = js.Cost(running=lambda x, u, t, p: u @ u)
    asked = double_integrator(cost, js.Time(NODES, js.FreeTime(0.5, 5.0)))
    asked = dataclasses.replace(asked, constraints=(band,))
    guess = js.straight_line(asked, 2.0)
    problem = over_scaled_time(canonical(asked), Continuous(), guess)
    random = np.random.default_rng(0)
    z = problem.join(guess.state, guess.control, guess.dilation)
    z += 0.1 * random.standard_normal(z.shape)
    y = jax.tree.map(
        lambda v: jnp.asarray(random.uniform(0.5, 1.5, v.shape)), no_multipliers(problem, z, GRID)
    )
    point = Point(z, y)
    move = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), point)
    expected = jax.jit(lambda p, d: jax.jvp(lambda q: conditions(problem, q, GRID), (p,), (d,))[1])(
        point, move
    )
    system = sensitivity._system(problem, point, GRID)
    inputs = riccati.KKTVector(move.z, move.y.flow, move.y.initial, move.y.final)
    found, rows = system._apply(problem, (scaled(inputs, 1.0 / system.scale), move.y.values))
    found = scaled(found, 1.0 / system.scale)
    ours = (found.nodes, found.flow, found.initial, found.final, *rows)
    theirs = (expected.z, expected.y.flow, expected.y.initial, expected.y.final, *expected.y.values)
    for one, other in zip(ours, theirs, strict=True):
        size = float(jnp.max(jnp.abs(other), initial=0.0))
        np.testing.assert_allclose(one, other, rtol=0.0, atol=ROUNDING * max(size, 1.0))
