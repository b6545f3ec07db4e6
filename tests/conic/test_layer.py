"""Conic layer: derivatives against diffcp, differences and closed forms; and cases without derivative."""

import diffcp
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

from jaxscp.conic import ConicLayer, StagedProgram, export
from jaxscp.conic.random_programs import random_program, smallest_program

SAME_SLOPE = 1e-6  # of the largest slope; diffcp's own solver stops at about 1e-10
DIFFERENCES = 1e-6  # of the largest slope; central differences with a step of 1e-5
PATH = 1e-9  # effect of a mu of 1e-12, in programs of unit size
TIE = 1e-6  # the same where a constraint is weakly active: the root of mu
ROUNDING = 1e-8  # relative; sums whose terms cancel

kinds = pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])


def outputs(program: StagedProgram):
    solution = ConicLayer()(program)
    return (solution.z, solution.multipliers, solution.objective), solution.differentiable


@jax.jit
def forward(program, change):
    values, slopes, differentiable = jax.jvp(outputs, (program,), (change,), has_aux=True)
    return values, slopes, differentiable


@jax.jit
def reverse(program, weight):
    _, transpose_product, differentiable = jax.vjp(outputs, program, has_aux=True)
    return transpose_product(weight)[0], differentiable


def random_change(program: StagedProgram, seed: int) -> StagedProgram:
    """Direction that changes every number except zeros, which are padding, and the mask of soft rows."""
    random = np.random.default_rng(seed)
    change = jax.tree.map(lambda v: v * random.standard_normal(v.shape), program)
    hessian = change.hessian + jnp.swapaxes(change.hessian, 1, 2)
    return eqx.tree_at(
        lambda p: (p.hessian, p.links.soft), change, (hessian, jnp.zeros_like(change.links.soft))
    )


def moved(program, change, step):
    return jax.tree.map(lambda v, d: v + step * d, program, change)


def close(found, expected, tolerance):
    size = max(1.0, *(float(np.max(np.abs(v), initial=0.0)) for v in jax.tree.leaves(expected)))
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=tolerance * size, rtol=0.0), found, expected
    )


# --- against diffcp ---


class Cone:
    """Program in diffcp's form: linear cost; an extra variable per node bounds |root' z|^2 / 2."""

    def __init__(self, program: StagedProgram, root):
        p = export(eqx.tree_at(lambda q: q.hessian, program, jnp.zeros_like(program.hessian)))
        nodes, n = program.nodes if root is not None else 0, program.variables
        self.columns = p.q.size
        rows, right = [sp.hstack([p.A, sp.csc_matrix((p.A.shape[0], nodes))])], [p.b]
        for k in range(nodes):
            block = sp.lil_matrix((n + 2, p.q.size + nodes))
            block[0, p.q.size + k], block[1, p.q.size + k] = -1.0, 1.0
            block[2:, k * n : (k + 1) * n] = -np.sqrt(2.0) * np.asarray(root[k]).T
            rows.append(block)
            right.append(np.concatenate([[1.0, 1.0], np.zeros(n)]))
        self.A, self.b = sp.vstack(rows, format="csc"), np.concatenate(right)
        self.c = np.concatenate([p.q, np.ones(nodes)])
        self.cones = {"z": p.zero, "l": p.nonnegative, "q": [*p.second_order, *(n + 2,) * nodes]}


def unpacked(program: StagedProgram, x, y):
    """z, and multipliers of half-spaces and user's cones, from the exported program's vectors."""
    p = export(program)
    _, rows, cones = np.split(
        y[: p.zero + p.nonnegative + 3 * program.nodes], [p.zero, p.zero + p.nonnegative]
    )
    return (
        p.node_variables(x),
        rows.reshape(program.rows.offset.shape),
        cones.reshape(program.cones[0].offset.shape),
    )


@kinds
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_slopes_are_diffcps(seed, norm):
    program = random_program(seed, norm=norm)
    change = random_change(program, seed)
    root = root_change = None
    if not norm:
        root = np.linalg.cholesky(program.hessian)
        root_change = np.random.default_rng(seed).standard_normal(root.shape)
        product = root_change @ np.swapaxes(root, 1, 2)
        change = eqx.tree_at(lambda p: p.hessian, change, jnp.asarray(product + np.swapaxes(product, 1, 2)))

    def data(step):
        return Cone(moved(program, change, step), None if norm else root + step * root_change)

    here, forwards, backwards = data(0.0), data(1e-2), data(-1e-2)
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-14)
    x, y, _, derivative, _ = diffcp.solve_and_derivative(
        here.A, here.b, here.c, here.cones, mode="dense", solve_method="CLARABEL", **tolerances
    )
    # Central differences are exact, since the data are quadratic polynomials in the step.
    dA, db, dc = ((getattr(forwards, k) - getattr(backwards, k)) / 2e-2 for k in ("A", "b", "c"))
    dx, dy, _ = derivative(sp.csc_matrix(dA), db, dc)

    values, slopes, differentiable = forward(program, change)
    assert bool(differentiable)
    for (z, multipliers, _), expected in ((values, (x, y)), (slopes, (dx, dy))):
        close((z, multipliers.rows, multipliers.cones[0]), unpacked(program, *expected), SAME_SLOPE)


# --- against differences and itself ---


@kinds
@pytest.mark.parametrize("seed", range(6))
def test_slopes_are_differences(seed, norm):
    program = random_program(seed, norm=norm)
    change, still = random_change(program, seed), jax.tree.map(jnp.zeros_like, program)
    _, slopes, differentiable = forward(program, change)
    forwards, backwards = (forward(moved(program, change, h), still)[0] for h in (1e-5, -1e-5))
    assert bool(differentiable)
    close(slopes, jax.tree.map(lambda a, b: (a - b) / 2e-5, forwards, backwards), DIFFERENCES)


@pytest.mark.slow
@kinds
def test_reverse_mode_is_the_transpose_of_forward_mode(norm):
    program = random_program(7, norm=norm)
    change = random_change(program, 7)
    values, slopes, _ = forward(program, change)
    random = np.random.default_rng(7)
    weight = jax.tree.map(lambda v: jnp.asarray(random.standard_normal(v.shape)), values)
    gradient, _ = reverse(program, weight)
    pairs = ((weight, slopes), (gradient, change))
    along, back = (sum(map(jnp.vdot, *map(jax.tree.leaves, pair))) for pair in pairs)
    np.testing.assert_allclose(along, back, rtol=ROUNDING)


# --- closed forms ---


class Step(eqx.Module):
    """Data of a one-step program: from 0 to a target by a first force, with penalised virtual control."""

    target: jax.Array
    limit: jax.Array
    weight: jax.Array
    """Penalty weight of virtual control."""
    curvature: jax.Array
    """Cost of half the square of the first force."""
    last_gradient: jax.Array
    """Linear cost of the second force, which moves nothing."""
    last_curvature: jax.Array
    last_limit: jax.Array


def step_program(step: Step, like: StagedProgram) -> StagedProgram:
    """The smallest program with these data; all rows of its last link have the target as offset."""
    nothing = jnp.zeros(())
    return eqx.tree_at(
        lambda p: (p.hessian, p.gradient, p.links.offset, p.links.weight, p.rows.offset),
        like,
        (
            jax.vmap(jnp.diag)(
                jnp.stack([nothing, step.curvature, nothing, step.last_curvature]).reshape(2, 2)
            ),
            like.gradient.at[1, 1].set(step.last_gradient),
            like.links.offset.at[2].set(step.target),
            jnp.broadcast_to(step.weight, (3,)),
            jnp.stack([step.limit, jnp.full((), 2.0), step.last_limit, jnp.full((), 2.0)]).reshape(2, 2),
        ),
    )


def steps(*elements) -> Step:
    """Batch of (target, limit, weight, curvature) and, for the last force, (gradient, curvature, limit)."""
    return Step(*jnp.array(elements).T)


def solved(step: Step, like: StagedProgram | None = None):
    solution = ConicLayer()(step_program(step, smallest_program() if like is None else like))
    answer = (
        solution.z,
        solution.multipliers.links[2, 0],
        solution.multipliers.rows[0, 0],
        solution.objective,
    )
    return answer, (answer, solution.differentiable)


ENOUGH = (1.5, 2.0, 10.0, 3.0, 0.0, 1.0, 2.0)
TOO_LITTLE = (3.5, 2.0, 10.0, 3.0, 0.0, 1.0, 2.0)
IMPOSSIBLE = (1.5, -3.0, 10.0, 3.0, 0.0, 1.0, 2.0)  # a force below -3 and above -2
ON_THE_LIMIT = (1.5, 2.0, 10.0, 3.0, 0.0, 1.0, 0.0)  # the last force is optimal at zero
UNDECIDED = (1.5, 2.0, 10.0, 3.0, 0.0, 0.0, 2.0)  # any last force is optimal


@pytest.fixture(scope="module")
def slopes():
    """Jacobians, values and flags of a batch of all cases."""
    batch = steps(ENOUGH, TOO_LITTLE, IMPOSSIBLE, ON_THE_LIMIT, UNDECIDED)
    jacobian, (values, differentiable) = jax.jit(jax.vmap(jax.jacfwd(solved, has_aux=True)))(batch)
    return jacobian, values, differentiable


def element_of(tree, index):
    return jax.tree.map(lambda v: v[index], tree)


def test_slopes_where_the_force_is_enough(slopes):
    """u = d at cost h d^2 / 2, independent of weight and limit."""
    (z, link, row, cost), values, differentiable = element_of(slopes, 0)
    d, *_, h = ENOUGH[:4]
    assert bool(differentiable)
    close(values, (jnp.array([[0.0, d], [d, 0.0]]), -h * d, 0.0, 0.5 * h * d**2), PATH)
    close(z.target, [[0.0, 1.0], [1.0, 0.0]], PATH)
    close((link.target, link.curvature), (-h, -d), PATH)
    close((cost.target, cost.curvature), (h * d, 0.5 * d**2), PATH)
    for slope in (z, link, row, cost):
        close((slope.limit, slope.weight), jax.tree.map(jnp.zeros_like, (slope.limit, slope.weight)), PATH)


def test_slopes_where_virtual_control_does_the_rest(slopes):
    """u = l, virtual control d - l at weight W: cost h l^2 / 2 + W (d - l), multiplier of the limit W - h l."""
    (z, link, row, cost), values, differentiable = element_of(slopes, 1)
    d, l, w, h = TOO_LITTLE[:4]
    assert bool(differentiable)
    close(values, (jnp.array([[0.0, l], [d, 0.0]]), -w, w - h * l, 0.5 * h * l**2 + w * (d - l)), PATH)
    close((z.target, z.limit), ([[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]), PATH)
    close((z.weight, z.curvature), (np.zeros((2, 2)), np.zeros((2, 2))), PATH)
    close((link.target, link.limit, link.weight), (0.0, 0.0, -1.0), PATH)
    close((row.target, row.limit, row.weight, row.curvature), (0.0, -h, 1.0, -l), PATH)
    close((cost.target, cost.limit, cost.weight, cost.curvature), (w, h * l - w, d - l, 0.5 * l**2), PATH)


def test_without_solution_there_are_values_but_no_slopes(slopes):
    jacobian, values, differentiable = element_of(slopes, 2)
    assert not bool(differentiable)
    assert np.all(np.isfinite(values[0]))
    assert np.all(np.isnan(jacobian[0].target))
    assert np.isnan(jacobian[3].target)


def test_on_a_limit_the_slope_is_between_those_of_both_sides(slopes):
    """The last force is -g / h below the limit and zero at the limit: slopes -1 and 0; on the path -1/2."""
    (z, *_), _, differentiable = element_of(slopes, 3)
    assert bool(differentiable)
    close(z.last_gradient, [[0.0, 0.0], [0.0, -0.5]], TIE)


def test_only_the_direction_that_is_not_unique_has_no_slope(slopes):
    (z, *_, cost), _, differentiable = element_of(slopes, 4)
    assert not bool(differentiable)
    assert np.all(np.isnan(z.last_gradient))
    close((z.target, cost.target), ([[0.0, 1.0], [1.0, 0.0]], ENOUGH[3] * ENOUGH[0]), PATH)


@pytest.mark.slow
def test_masked_batch_elements_have_zero_slopes_and_do_no_harm():
    def masked(batch):
        (*_, costs), (_, differentiable) = jax.vmap(solved)(batch)
        return jnp.sum(jnp.where(differentiable, costs, 0.0))

    gradient = jax.jit(jax.grad(masked))(steps(IMPOSSIBLE, ENOUGH, UNDECIDED))
    close(gradient.target, [0.0, ENOUGH[3] * ENOUGH[0], 0.0], PATH)


@pytest.mark.slow
def test_redundant_links_do_no_harm():
    """The target twice, and rows of zeros elsewhere: only the multipliers are not unique."""
    program = smallest_program()
    padded = jax.tree.map(
        lambda v: jnp.concatenate([v, jnp.zeros_like(v)], axis=1) if v.ndim > 1 else v, program.links
    )
    padded = eqx.tree_at(lambda v: v.before, padded, padded.before.at[2, 1].set(padded.before[2, 0]))
    wide = eqx.tree_at(lambda p: p.links, program, padded)
    step = element_of(steps(ENOUGH), 0)
    (z, *_, cost), _ = jax.jit(jax.jacfwd(lambda s: solved(s, wide), has_aux=True))(step)
    close((z.target, cost.target), ([[0.0, 1.0], [1.0, 0.0]], ENOUGH[3] * ENOUGH[0]), PATH)


def test_second_derivatives_are_refused():
    step = element_of(steps(ENOUGH), 0)
    with pytest.raises(TypeError, match="first derivatives only"):
        jax.eval_shape(jax.hessian(lambda s: solved(s)[0][3]), step)
