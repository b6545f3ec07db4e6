"""User functions are known by what they compute: what traces, what compiles, and what is told apart."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from jaxscp.core import program
from jaxscp.problem.canonical import canonical
from tests.support.own_problems import double_integrator

GUESS = js.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [1.0, 0.0]], np.zeros((2, 1)))
TIME = js.Time(6, js.FixedTime(2.0))
EXACT = 1.5  # 12 d^2 / T^3
BARRIER = 1e-5  # relative


def energy(weight=1.0):
    """A problem whose functions are made anew in every call."""
    return double_integrator(js.Cost(lambda x, u, t, p: p * u @ u, parameters=weight), TIME)


class Compilations:
    """Counts what JAX compiles."""

    def __init__(self):
        self.count = 0
        jax.monitoring.register_event_duration_secs_listener(self._listen)

    def _listen(self, event, *_, **__):
        self.count += event == "/jax/core/compile/backend_compile_duration"


COMPILATIONS = Compilations()


def compilations(call):
    before = COMPILATIONS.count
    call()
    return COMPILATIONS.count - before


@pytest.fixture(scope="module", autouse=True)
def warm():
    """The first call compiles."""
    assert compilations(lambda: js.solve(energy(), GUESS)) > 0


def test_an_equal_lambda_compiles_nothing():
    js.solve(energy(3.0), GUESS)
    assert compilations(lambda: js.solve(energy(2.0), GUESS)) == 0


def test_the_same_problem_traces_nothing(monkeypatch):
    problem = double_integrator(js.Cost(lambda x, u, t, p: p * u @ u, parameters=1.0), TIME)
    js.solve(problem, GUESS)
    traced = []
    whole = program.traced
    monkeypatch.setattr(program, "traced", lambda *arguments: traced.append(1) or whole(*arguments))
    assert compilations(lambda: js.solve(problem, GUESS)) == 0
    assert not traced
    weight = types.SimpleNamespace(k=1.0)  # an object's attributes cannot be compared
    compilations(
        lambda: js.solve(double_integrator(js.Cost(lambda x, u, t, p: weight.k * u @ u), TIME), GUESS)
    )
    assert traced


@pytest.mark.slow
def test_another_number_inside_a_function_is_another_program():
    costs = [
        float(js.solve(double_integrator(js.Cost(lambda x, u, t, p, k=k: k * u @ u), TIME), GUESS).cost)
        for k in (1.0, 2.0)
    ]
    np.testing.assert_allclose(costs, [EXACT, 2.0 * EXACT], rtol=BARRIER)


@pytest.mark.slow
def test_a_number_that_changes_outside_of_a_function_is_seen():
    weight = {"k": 1.0}
    scale = 1.0

    def running(x, u, t, p):
        return scale * u @ u

    problem = double_integrator(js.Cost(running), TIME)
    first = js.solve(problem, GUESS).cost
    scale = 2.0
    np.testing.assert_allclose(js.solve(problem, GUESS).cost, 2.0 * first, rtol=BARRIER)
    assert weight["k"] == 1.0


def drifting(drift):
    """Dynamics behind a ``jit`` of its own, which closes over an array."""
    pushed = jax.jit(lambda x, u: jnp.stack([x[1], u[0] + drift[1]]))
    return js.Dynamics.of(lambda x, u, t, p: pushed(x, u), 2, 1)


def drift_cost(constant):
    """A constant acceleration adds nothing to the speed at the end, so that the control takes it back."""
    return EXACT + 2.0 * constant**2


@pytest.mark.nightly
@pytest.mark.parametrize("with_folder", [False, True])
def test_arrays_inside_a_jit_are_told_apart(with_folder, tmp_path):
    """Also by the cache's folder."""
    previous = js.use_cache(tmp_path) if with_folder else None
    try:
        for constant in (0.5, -1.0):
            problem = double_integrator(js.Cost(lambda x, u, t, p: u @ u), TIME)
            problem = jax.tree_util.tree_map(lambda v: v, problem)
            problem = js.OptimalControlProblem(
                drifting(jnp.array([0.0, constant])), problem.cost, problem.boundary, problem.time
            )
            solution = js.solve(problem, GUESS)
            np.testing.assert_allclose(solution.cost, drift_cost(constant), rtol=BARRIER)
        if with_folder:
            assert len(list(tmp_path.glob("planner-*.jaxscp"))) == 2
    finally:
        if with_folder:
            js.use_cache(None)
    assert previous is None


@pytest.mark.nightly
def test_derivatives_and_batches_over_a_closed_over_number():
    """The cost is k times a constant."""

    def cost(k):
        return js.solve(double_integrator(js.Cost(lambda x, u, t, p: k * u @ u), TIME), GUESS).cost

    np.testing.assert_allclose(jax.grad(cost)(2.0), EXACT, rtol=BARRIER)
    ks = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(jax.vmap(cost)(ks), EXACT * ks, rtol=BARRIER)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(cost)))(ks), EXACT, rtol=BARRIER)


def test_many_versions_of_one_line_are_warned_of():
    versions = [
        double_integrator(js.Cost(lambda x, u, t, p, k=k: k * u @ u), TIME) for k in (1.1, 1.2, 1.3, 1.4)
    ]
    with pytest.warns(UserWarning, match="pass the number in parameters"):
        for_each(canonical, versions)


def for_each(function, values):
    for value in values:
        function(value)


def test_compiled_solver_refuses_other_problems():
    compiled = js.Solver().compile(energy(), GUESS)
    np.testing.assert_allclose(compiled(energy(2.0), GUESS.resampled(6)).cost, 2.0 * EXACT, rtol=BARRIER)
    other = double_integrator(js.Cost(lambda x, u, t, p: p * u @ u + p, parameters=1.0), TIME)
    with pytest.raises(TypeError, match="functions or parts are not those"):
        compiled(other, GUESS.resampled(6))
    numbers = energy().arrays()
    with pytest.raises(TypeError, match=r"'cost\.parameters' is missing"):
        compiled({k: v for k, v in numbers.items() if k != "cost.parameters"}, GUESS.resampled(6))
    with pytest.raises(TypeError, match=r"another shape: .*guess"):
        compiled(numbers, GUESS)
