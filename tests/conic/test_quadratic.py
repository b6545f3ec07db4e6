"""Quadratic form: its cost and its cones against their definitions."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.conic import Cones
from jaxscp.conic.quadratic import quadratic_form
from jaxscp.conic.random_programs import random_program
from tests.support.reference import clarabel_optimum

ROUNDING = 1e-10


def reference(form) -> tuple[str, float]:
    equalities = form.equalities.offset.size
    sizes = (equalities, form.u.size - equalities, ())
    status, value = clarabel_optimum(form.P, form.q, form.A, form.u, sizes)
    return status, value + form.constant


def random_point(program, seed):
    return jnp.asarray(np.random.default_rng(seed).standard_normal(program.gradient.shape))


def with_auxiliary(form, z):
    """Variables of the form at a point, with auxiliary variables as small as their rows allow."""
    deviation = (np.asarray(z) - form.centre).ravel()
    x = np.concatenate([deviation, np.zeros(form.q.size - deviation.size)])
    slack = form.u - form.A @ x  # slack of a row +-v - a <= 0 at a = 0: negative by |v| for one of the signs
    for column in range(deviation.size, form.q.size):
        rows = form.A[:, [column]].nonzero()[0]
        rows = rows[form.A[rows, column].toarray().ravel() < 0]
        x[column] = max(0.0, -slack[rows].min())
    return x


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
def test_cost_is_the_one_norms(norm):
    program = random_program(0, norm=norm)
    form, z = quadratic_form(program), random_point(program, 1)
    expected = jnp.vdot(program.gradient, z) + 0.5 * jnp.einsum("ki,kij,kj->", z, program.hessian, z)
    expected += jnp.sum(program.links.weight[:, None] * jnp.abs(program.virtual_control(z)))
    if norm:
        step = program.norm.scale * (z - program.norm.centre)
        expected += jnp.sum(program.norm.weight[:, None] * jnp.abs(step))
    np.testing.assert_allclose(form.objective(with_auxiliary(form, z)), expected, rtol=ROUNDING)
    assert float(expected) >= float(program.objective(z))  # an upper bound of the Euclidean cost


@pytest.mark.parametrize(("dimension", "exact"), [(2, True), (3, False), (4, False)])
def test_cones_are_approximated_from_inside(dimension, exact):
    """A point that is feasible for the form is in the cone; a point near the cone's axis is feasible."""
    base = random_program(1, nodes=3, variables=4)
    matrix = -jnp.broadcast_to(jnp.eye(4)[:dimension], (3, 1, dimension, 4))
    program = eqx.tree_at(lambda p: p.cones, base, (Cones(matrix, jnp.zeros((3, 1, dimension))),))
    form = quadratic_form(program, facets=8)
    cone_rows = slice(
        form.equalities.offset.size + form.blocks[0].combination.shape[0],
        form.equalities.offset.size + sum(block.combination.shape[0] for block in form.blocks[:-2]),
    )
    random = np.random.default_rng(2)
    inner = {3: np.cos(np.pi / 8), 4: 1.0 / np.sqrt(3.0)}.get(dimension, 1.0)
    for _ in range(50):
        z = random.standard_normal((3, 4))
        z[:, 0] = np.abs(z[:, 0])
        radius = np.linalg.norm(z[:, 1:dimension], axis=1)
        x = with_auxiliary(form, z)
        allowed = np.all((form.A @ x - form.u)[cone_rows] <= ROUNDING)
        if allowed:
            assert np.all(radius <= z[:, 0] + ROUNDING)
        if np.all(radius <= inner * z[:, 0]):
            assert allowed
        if exact:
            assert allowed == np.all(radius <= z[:, 0])


def test_more_facets_come_closer():
    program = random_program(3)
    values = [reference(quadratic_form(program, facets))[1] for facets in (4, 8, 16, 64)]
    exact = quadratic_form(eqx.tree_at(lambda p: p.cones, program, ()))  # lower bound: no cones
    assert values == sorted(values, reverse=True)
    assert values[-1] >= reference(exact)[1] - 1e-7
