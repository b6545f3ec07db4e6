"""Sparse export: cost and constraint violation equal the staged program's at any point."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.conic import export
from jaxscp.conic.random_programs import random_program, smallest_program
from tests.support.reference import clarabel_optimum

ROUNDING = 1e-10

programs = pytest.mark.parametrize(
    "program",
    [random_program(0), random_program(1, norm=False), smallest_program()],
    ids=["norm cost", "quadratic cost", "smallest"],
)


def sections(p, rows):
    """Rows of the zero cone, of the orthant, and of each second-order cone."""
    return np.split(rows, np.cumsum([p.zero, p.nonnegative, *p.second_order])[:-1])


def with_bounds(p, z):
    """Variables of the export at a point, with every bound as small as its cone allows."""
    x = np.concatenate([np.asarray(z).ravel(), np.zeros(p.q.size - z.size)])
    cones = sections(p, p.b - p.A @ x)[2:]
    bounded = cones[len(cones) - (p.q.size - z.size) :]
    x[z.size :] = [np.linalg.norm(cone[1:]) for cone in bounded]
    return x


def cost(p, x):
    upper = p.P
    full = upper + upper.T
    return 0.5 * x @ (full @ x) - 0.5 * x @ (upper.diagonal() * x) + p.q @ x


def violation(p, x):
    zero, orthant, *cones = sections(p, p.b - p.A @ x)
    outside = [np.linalg.norm(cone[1:]) - cone[0] for cone in cones]
    return max(np.max(np.abs(zero), initial=0.0), np.max(-orthant, initial=0.0), *outside)


@programs
def test_same_cost_at_every_point(program):
    p = export(program)
    for seed in range(3):
        z = jnp.asarray(np.random.default_rng(seed).standard_normal(program.gradient.shape))
        np.testing.assert_allclose(cost(p, with_bounds(p, z)), program.objective(z), rtol=ROUNDING)


def test_violation_is_the_same_at_penalty_weight_one():
    """Rows of links are scaled by their penalty weight; at weight one all rows equal the staged program's."""
    program = random_program(2)
    program = eqx.tree_at(lambda q: q.links.weight, program, jnp.ones_like(program.links.weight))
    p = export(program)
    for seed in range(3):
        z = jnp.asarray(np.random.default_rng(seed).standard_normal(program.gradient.shape))
        np.testing.assert_allclose(
            violation(p, with_bounds(p, z)), program.violation(z), rtol=ROUNDING, atol=ROUNDING
        )


def test_rows_of_a_link_are_scaled_by_its_penalty_weight():
    program = smallest_program()
    heavier = eqx.tree_at(lambda q: q.links.weight, program, 100.0 * program.links.weight)
    light, heavy = export(program), export(heavier)
    np.testing.assert_allclose(heavy.b[: heavy.zero], 100.0 * light.b[: light.zero])
    np.testing.assert_array_equal(heavy.q, light.q)


def test_rows_that_hold_everywhere_are_left_out():
    program = random_program(3)
    padded = eqx.tree_at(
        lambda q: (q.rows.matrix, q.rows.offset, q.cones[0].matrix, q.cones[0].offset),
        program,
        (
            program.rows.matrix.at[2, 1].set(0.0),
            program.rows.offset.at[2, 1].set(1.0),
            program.cones[0].matrix.at[1, 0].set(0.0),
            program.cones[0].offset.at[1, 0].set(jnp.array([1.0, 0.0, 0.0])),
        ),
    )
    full, thin = export(program), export(padded)
    assert thin.nonnegative == full.nonnegative - 1
    assert len(thin.second_order) == len(full.second_order) - 1


def test_contradictory_rows_of_zeros_remain():
    program = random_program(3)
    rows = (program.rows.matrix.at[2, 1].set(0.0), program.rows.offset.at[2, 1].set(-1.0))
    p = export(eqx.tree_at(lambda q: (q.rows.matrix, q.rows.offset), program, rows))
    status, _ = clarabel_optimum(p.P, p.q, p.A, p.b, (p.zero, p.nonnegative, p.second_order))
    assert status == "PrimalInfeasible"


def test_node_variables_come_first():
    program = random_program(4)
    p = export(program)
    z = np.arange(program.gradient.size, dtype=float).reshape(program.gradient.shape)
    np.testing.assert_array_equal(p.node_variables(with_bounds(p, z)), z)
