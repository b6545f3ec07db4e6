"""The interior point started near a point that is thought to be not far: sooner there, and the same answer."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import status_names
from jaxscp.cones import product
from jaxscp.conic import kkt
from jaxscp.conic.equilibrate import equilibrate
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, WarmStart
from jaxscp.conic.random_programs import random_program
from jaxscp.conic.warm_start import AT_BOUND, LEAST, MOST, ROOM, central_start

SAME_COST = 1e-6  # relative: both answers are as accurate as the solver's tolerance
ROUNDING = 1e-9  # relative, as for the loop from afar
STEPS = 3


@pytest.fixture(
    scope="module",
    params=[pytest.param(True, id="compiled"), pytest.param(False, id="JAX", marks=pytest.mark.slow)],
)
def solvers(request):
    """From afar and from near."""
    solver = InteriorPoint(compiled=request.param)
    return eqx.filter_jit(solver), eqx.filter_jit(lambda program, near: solver(program, 0.0, near))


def near_of(solution) -> WarmStart:
    return WarmStart(solution.z, solution.multipliers)


def moved(program, size: float):
    """The program with other data, as a next subproblem has."""
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
def test_a_solution_nearby_saves_steps(solvers, seed):
    afar, near = solvers
    before = random_program(seed, norm=False)  # of the multipliers of a norm's cost nothing is kept
    program = moved(before, 1e-3)
    expected = afar(program)
    found = near(program, near_of(afar(before)))
    assert status_names(found.status) == status_names(expected.status) == "converged"
    assert int(found.iterations) <= int(expected.iterations) - 2
    np.testing.assert_allclose(found.objective, expected.objective, rtol=SAME_COST)


@pytest.mark.parametrize("what", ["far", "NaN", "wrong signs", "zeros"])
@pytest.mark.parametrize("kind", ["feasible", "infeasible", "unbounded"])
def test_a_useless_point_does_no_harm(solvers, kind, what):
    afar, near = solvers
    program = random_program(1, kind=kind)
    zeros = WarmStart(jnp.zeros_like(program.gradient), ConicMultipliers.zeros(program))
    noise = lambda v: 1e3 * jax.random.normal(jax.random.key(v.size), v.shape)  # noqa: E731
    useless = {
        "far": lambda: jax.tree.map(noise, (zeros.z, zeros.multipliers)),
        "NaN": lambda: (zeros.z * jnp.nan, zeros.multipliers),
        "wrong signs": lambda: (zeros.z, jax.tree.map(lambda v: v - 10.0, zeros.multipliers)),
        "zeros": lambda: (zeros.z, zeros.multipliers),
    }[what]()
    expected, found = afar(program), near(program, WarmStart(*useless))
    assert status_names(found.status) == status_names(expected.status)
    assert bool(jnp.all(jnp.isfinite(found.z)))
    if kind == "feasible":
        np.testing.assert_allclose(found.objective, expected.objective, rtol=SAME_COST)


def test_where_nothing_is_known_it_starts_from_afar(solvers):
    afar, near = solvers
    program = random_program(2)
    nothing = WarmStart(program.gradient, ConicMultipliers.zeros(program), known=jnp.zeros((), bool))
    expected, found = afar(program), near(program, nothing)
    assert int(found.iterations) == int(expected.iterations)
    np.testing.assert_array_equal(found.z, expected.z)


def test_lanes_start_where_their_own_solution_is_thought_to_be():
    programs = [random_program(seed) for seed in range(3)]
    solver = jax.jit(InteriorPoint().__call__)
    nears = [near_of(solver(p)) for p in programs]
    nears[1] = eqx.tree_at(lambda n: n.z, nears[1], nears[1].z * jnp.nan)
    nears = [WarmStart(n.z, n.multipliers, jnp.ones((), bool)) for n in nears]
    started = jax.jit(lambda p, n: InteriorPoint()(p, 0.0, n))
    stacked = jax.tree.map(lambda *v: jnp.stack(v), *zip(programs, nears, strict=True))
    together = jax.jit(jax.vmap(lambda p, n: InteriorPoint()(p, 0.0, n)))(*stacked)
    for lane, alone in enumerate(map(started, programs, nears)):
        np.testing.assert_array_equal(together.z[lane], alone.z)
        assert int(together.iterations[lane]) == int(alone.iterations)


@pytest.mark.parametrize(
    "norm",
    [pytest.param(True, id="norm cost"), pytest.param(False, id="quadratic cost", marks=pytest.mark.slow)],
)
def test_the_loop_starts_as_jax_does(norm):
    program = random_program(4, norm=norm)
    solution = jax.jit(InteriorPoint().__call__)(moved(program, 0.1))
    ours, jaxs = (
        jax.jit(lambda p, n, c=c: InteriorPoint(max_iterations=STEPS, compiled=c).iterate(p, None, n))(
            program, near_of(solution)
        )
        for c in (True, False)
    )
    assert int(ours.iterations) == int(jaxs.iterations)
    for one, other in zip(jax.tree.leaves(ours.iterate), jax.tree.leaves(jaxs.iterate), strict=True):
        size = max(1.0, float(jnp.max(jnp.abs(other), initial=0.0)))
        np.testing.assert_allclose(one, other, rtol=0, atol=ROUNDING * size)


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
def test_the_start_is_on_the_central_path_and_keeps_the_gap(norm):
    """s o y = mu e, and s - y is what the point has: s = b - A x, and y its multipliers.

    But for the trust region, whose bounds have room for moves.
    """
    program, _ = equilibrate(random_program(0, norm=norm))
    key = jax.random.key(0)
    given = WarmStart(
        program.gradient,
        jax.tree.map(lambda v: jax.random.normal(key, v.shape), ConicMultipliers.zeros(program)),
    )
    x, y, s = central_start(program, given)
    mu = float(s.orthant[0, 0] * y.orthant[0, 0])
    assert LEAST <= mu <= MOST
    np.testing.assert_array_equal(x.z, given.z)
    trust, _ = kkt.places(program)
    room = ROOM * mu / y.second[trust, 0]
    s = eqx.tree_at(lambda v: v.second, s, s.second.at[trust, 0].add(-room))
    identity = product.identity(s)
    product = product.product(s, y)
    np.testing.assert_allclose(product.orthant, mu * identity.orthant, rtol=ROUNDING)
    np.testing.assert_allclose(product.second, mu * identity.second, atol=ROUNDING)
    hard = 1.0 - program.links.soft
    np.testing.assert_array_equal(y.zero, hard * given.multipliers.links)
    gap = kkt.right_side(program).orthant - kkt.times_constraints(program, x).orthant - given.multipliers.rows
    np.testing.assert_allclose(s.orthant - y.orthant, gap, atol=ROUNDING)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_virtual_control_is_kept_where_its_multiplier_is_at_the_bound(share):
    """Elsewhere a solution has none: what the links lack is left to the steps."""
    program, _ = equilibrate(random_program(0))
    near = WarmStart(program.gradient, ConicMultipliers.zeros(program))
    soft, weight = program.links.soft, program.links.weight
    sizes = np.where(np.arange(len(weight)) == 1, share * AT_BOUND, 0.5) * weight
    links = sizes[:, None] * soft / jnp.sqrt(jnp.maximum(1.0, jnp.sum(soft, axis=1, keepdims=True)))
    near = eqx.tree_at(lambda n: n.multipliers.links, near, links)
    x, _, _ = central_start(program, near)
    virtual = np.linalg.norm(program.virtual_control(near.z), axis=1)
    assert np.min(virtual[1:3]) > 0.0
    np.testing.assert_allclose(x.zeta[1], virtual[1] if share > 1.0 else 0.0)
    np.testing.assert_array_equal(np.delete(x.zeta, 1), 0.0)


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize(
    "compiled",
    [pytest.param(True, id="compiled"), pytest.param(False, id="JAX", marks=pytest.mark.slow)],
)
def test_what_is_said_of_the_end_is_measured_there(compiled, norm):
    """Far from the end residuals are foreseen, which is not to be believed of an answer."""
    given = random_program(3, norm=norm)
    near = WarmStart(jnp.zeros_like(given.gradient), ConicMultipliers.zeros(given))
    loop = jax.jit(InteriorPoint(compiled=compiled).iterate)
    for enough in (1e-2, 1e-6):
        assert_measured(given, loop(given, jnp.asarray(enough), near), enough)


def assert_measured(given, end, enough: float):
    """That its error is what it is by definition, and enough."""
    program, scales = equilibrate(given)
    x, y, s = end.iterate.x, end.iterate.y, end.iterate.s
    q, b, curved = kkt.linear_cost(program), kkt.right_side(program), kkt.times_hessian(program, x)
    dual = product.tree_axpy(
        1.0, kkt.times_constraints_transpose(program, y), product.tree_axpy(1.0, curved, q)
    )
    primal = product.tree_axpy(1.0, kkt.times_constraints(program, x), product.tree_axpy(-1.0, b, s))
    half = 0.5 * product.tree_dot(x, curved)
    cost, bound = half + product.tree_dot(q, x), -half - product.tree_dot(b, y)
    gap = jnp.abs(cost - bound) / jnp.maximum(scales.cost, jnp.minimum(jnp.abs(cost), jnp.abs(bound)))
    lacks = [
        product.tree_max(v) / jnp.maximum(1.0, product.tree_max(of)) for v, of in ((primal, b), (dual, q))
    ]
    np.testing.assert_allclose(end.iterate.tau, 1.0)
    np.testing.assert_allclose(end.error, jnp.max(jnp.stack([gap, *lacks])), rtol=1e-6, atol=1e-12)
    assert float(end.error) <= enough
