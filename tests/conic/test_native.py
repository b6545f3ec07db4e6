"""Compiled loop of the interior point against the same loop as JAX."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import status_names
from jaxscp.conic import native
from jaxscp.conic.equilibrate import equilibrate
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.random_programs import random_program

pytestmark = pytest.mark.skipif(
    not native.LIBRARY.available(),
    reason="the interior point was not compiled: no C++ compiler at installation",
)

ROUNDING = (
    1e-9  # relative; a few steps amplify rounding that much, as the systems are solved to 1e-11 at worst
)
SAME_POINT = 1e-4  # optima of these programs are flat: both loops stop at a gap of 1e-8
SAME_SUMS = 1e-13  # relative; products of three numbers
STEPS = 4


def iterate(solver, program):
    return eqx.filter_jit(lambda p: solver.iterate(p))(program)


def assert_same(a, b, tolerance):
    for u, v in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        size = max(1.0, float(jnp.max(jnp.abs(u), initial=0.0)))
        np.testing.assert_allclose(v, u, rtol=0, atol=tolerance * size)


SHAPES = {
    "two nodes": {"nodes": 2},
    "links fill a pack": {"nodes": 7, "variables": 7},
    "links begin a pack": {"nodes": 8, "cones": 0, "norm": False},
    "three packs": {"nodes": 17, "variables": 10, "rows": 6, "cones": 2},
    "a link fills a register": {"nodes": 3, "variables": 16},
    "a link fills three": {"nodes": 33, "variables": 46, "rows": 6},
    "more entries than 16 bits count": {"nodes": 2, "variables": 7, "rows": 10_000},
}


# covered by the other shapes
BY_NIGHT = (
    "links fill a pack",
    "links begin a pack",
    "three packs",
    "a link fills a register",
    "a link fills three",
    "two nodes",
    "more entries than 16 bits count",
)


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param(shape, id=name, marks=[pytest.mark.nightly] if name in BY_NIGHT else [])
        for name, shape in SHAPES.items()
    ],
)
def test_steps_are_the_same_to_rounding(shape):
    program = random_program(1, **shape)
    ours, jaxs = (iterate(InteriorPoint(max_iterations=STEPS, compiled=c), program) for c in (True, False))
    assert int(ours.iterations) == int(jaxs.iterations)
    assert_same(jaxs.iterate, ours.iterate, ROUNDING)
    assert_same(jaxs.scales, ours.scales, SAME_SUMS)
    assert_same([jaxs.error, jaxs.infeasibility], [ours.error, ours.infeasibility], ROUNDING)


def test_many_groups_of_cones():
    """Many groups of cones, as many gates give, are as good as one group."""
    program = random_program(1)
    many = eqx.tree_at(lambda p: p.cones, program, program.cones * 9)
    joined = jax.tree.map(lambda v: jnp.concatenate([v] * 9, axis=1), program.cones)
    one = eqx.tree_at(lambda p: p.cones, program, joined)
    assert native.supports(many)
    assert_same(*(iterate(InteriorPoint(max_iterations=STEPS), p).iterate.x for p in (many, one)), ROUNDING)


@pytest.fixture(scope="module")
def both():
    return tuple(eqx.filter_jit(InteriorPoint(compiled=compiled)) for compiled in (True, False))


@pytest.mark.parametrize("norm", [True, False], ids=["norm cost", "quadratic cost"])
@pytest.mark.parametrize("kind", ["feasible", "infeasible", "unbounded"])
@pytest.mark.parametrize("seed", range(3))
def test_end_is_the_same(both, seed, kind, norm):
    program = random_program(seed, kind=kind, norm=norm)
    ours, jaxs = (solve(program) for solve in both)
    assert status_names(ours.status) == status_names(jaxs.status)
    assert abs(int(ours.iterations) - int(jaxs.iterations)) <= 1
    if kind == "feasible":
        assert_same(jaxs.z, ours.z, SAME_POINT)


@pytest.mark.nightly
def test_accuracy_of_each_batch_element():
    """Coarser elements take fewer steps, and their distance from the optimum agrees with their accuracy."""
    program = random_program(3, nodes=9)
    accuracies = jnp.array([0.0, 1e-5, 1e-2])
    for compiled in (True, False):
        solver = InteriorPoint(compiled=compiled)
        found = jax.jit(jax.vmap(solver, in_axes=(None, 0)))(program, accuracies)
        assert list(status_names(found.status)) == ["converged"] * 3
        steps = [int(n) for n in found.iterations]
        assert steps[0] > steps[1] > steps[2]
        error = jnp.abs(found.objective - found.objective[0]) / jnp.maximum(1.0, jnp.abs(found.objective[0]))
        assert 0.0 < error[1] < 1e-4
        assert error[1] < error[2] < 1e-1


def test_every_level_that_runs_here_gives_the_same(at_level):
    program = random_program(2, nodes=17)
    expected = iterate(InteriorPoint(max_iterations=STEPS), program)
    at_level(native, "TARGET")
    found = iterate(InteriorPoint(max_iterations=STEPS), program)
    assert_same(expected.iterate, found.iterate, ROUNDING)
    assert_same(expected.scales, found.scales, SAME_SUMS)


def test_batch_elements_are_bitwise_those_solved_alone(both):
    """A batch of batches, one element NaN and two with fewer entries: reused workers must forget the last element."""
    programs = [random_program(seed) for seed in range(6)]
    for element in (0, 4):
        after = programs[element].links.after
        fewer = after.at[:, :, 0].set(0.0)
        programs[element] = eqx.tree_at(lambda p: p.links.after, programs[element], fewer)
    poisoned = eqx.tree_at(lambda p: p.gradient, programs[2], programs[2].gradient * jnp.nan)
    batch = jax.tree.map(
        lambda *v: jnp.stack(v).reshape(2, 3, *v[0].shape), *programs[:2], poisoned, *programs[3:]
    )
    found = jax.tree.map(
        lambda v: v.reshape(6, *v.shape[2:]), jax.jit(jax.vmap(jax.vmap(InteriorPoint())))(batch)
    )
    for element in (0, 1, 3, 4, 5):
        np.testing.assert_array_equal(found.z[element], both[0](programs[element]).z)


def test_result_does_not_depend_on_the_number_of_threads():
    """All free threads solve a single program together; a batch has one thread per element."""
    program = random_program(3, nodes=40)
    pair = jax.tree.map(lambda v: jnp.stack([v, v]), program)
    expected = jax.jit(jax.vmap(InteriorPoint().iterate))(pair)
    alone = jax.jit(InteriorPoint().iterate)
    for _ in range(100):
        for one, of_pair in zip(jax.tree.leaves(alone(program)), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(one, of_pair[0])


def test_float32_and_refusal_run_as_jax():
    program = random_program(0)
    calls = lambda solver, p: native.TARGET in jax.jit(solver.__call__).lower(p).as_text()  # noqa: E731
    assert calls(InteriorPoint(), program)
    assert not calls(InteriorPoint(compiled=False), program)
    small = jax.tree.map(lambda v: v.astype(jnp.float32), program)
    assert not native.supports(small)


def test_a_program_of_several_kinds_of_numbers_is_scaled_too():
    program = random_program(0)
    matrix = lambda p: p.rows.matrix  # noqa: E731
    mixed = eqx.tree_at(matrix, program, matrix(program).astype(jnp.float32))
    same = eqx.tree_at(matrix, program, matrix(mixed).astype(jnp.float64))
    assert not native.supports(mixed)
    with jax.numpy_dtype_promotion("standard"):
        _, expected = jax.jit(equilibrate)(same)
        _, found = jax.jit(equilibrate)(mixed)
    assert_same(expected, found, 1e-6)  # some of it is computed in float32


@pytest.mark.parametrize("batched", [False, True], ids=["one", "batch"])
def test_another_device_runs_jax(batched, monkeypatch):
    """If JAX's default device is a GPU, one traced program has the loop of each device."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    solver = InteriorPoint(max_iterations=1)
    program, solve = random_program(0), solver.__call__
    if batched:
        program, solve = jax.tree.map(lambda v: jnp.stack([v, v]), program), jax.vmap(solve)
    traced = jax.jit(solve).trace(program)
    for platform in ("cpu", "cuda"):
        text = traced.lower(lowering_platforms=(platform,)).as_text()
        assert (native.TARGET in text) == (platform == "cpu")


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_scales_are_those_of_jax(shape):
    program = random_program(2, **shape)
    program = eqx.tree_at(
        lambda p: (p.hessian, p.rows.matrix, p.links.soft),
        program,
        (
            1e3 * program.hessian.at[:, :, 0].set(0.0).at[:, 0].set(0.0),
            program.rows.matrix.at[0, 0].set(0.0),  # an empty row keeps its scale
            program.links.soft.at[0].set(0.0),
        ),
    )
    without = eqx.tree_at(lambda p: p.norm, program, None, is_leaf=lambda v: v is None)
    for given, rounds in ((program, 3), (without, 1)):
        _, expected = jax.jit(lambda p, rounds=rounds: equilibrate(p, rounds))(given)
        solver = InteriorPoint(max_iterations=0, equilibration=rounds)
        found = jax.jit(lambda p, solver=solver: solver.iterate(p).scales)(given)
        assert_same(expected, found, SAME_SUMS)
