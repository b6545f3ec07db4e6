"""Problems of the user's own, through the front door: optima, batches, gradients, files, and what compiles."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from tests.support.own_problems import CASES

SAME = 1e-8  # relative: a batch and single calls end at the same optimum, to the interior point's tolerance
DIFFERENCE = 1e-4  # relative: a gradient against central differences
STEP = 1e-3  # of differences, relative to the number
BATCH = 16

# Each case compiles for ten seconds or more. The gallery stands for all in the short tests.
EVERY_CASE = pytest.mark.parametrize("name", CASES)


def request_of(name):
    case = CASES[name]
    problem = case.problem(case.value)
    return case, problem, case.guess(problem)


def solve_with(name, guess, number):
    return js.solve(CASES[name].problem(number), guess)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n == "Dubins" else pytest.mark.nightly) for n in CASES]
)
def test_optimum(name):
    """Cost of the exact optimum, and a certificate that passed."""
    case, problem, guess = request_of(name)
    solution = js.solve(problem, guess)
    assert js.status_names(solution.status) == "converged"
    assert bool(solution.differentiable)
    assert bool(solution.certificate.passed())
    np.testing.assert_allclose(solution.cost, case.exact(case.value), rtol=case.error)


@pytest.mark.nightly
@EVERY_CASE
def test_batch_equals_single_calls(name):
    case, _, guess = request_of(name)
    numbers = case.value * np.linspace(0.97, 1.03, BATCH)
    batch = jax.vmap(lambda v: solve_with(name, guess, v))(jnp.asarray(numbers))
    singles = [solve_with(name, guess, float(v)) for v in numbers]
    assert set(js.status_names(batch.status)) == {"converged"}
    np.testing.assert_allclose(batch.cost, [float(s.cost) for s in singles], rtol=SAME)
    np.testing.assert_allclose(batch.final_time, [float(s.final_time) for s in singles], rtol=SAME)


@pytest.mark.nightly
@EVERY_CASE
def test_gradient_agrees_with_differences(name):
    case, _, guess = request_of(name)
    cost = lambda v: solve_with(name, guess, v).cost  # noqa: E731
    gradient = jax.grad(cost)(case.value)
    step = STEP * case.value
    difference = (cost(case.value + step) - cost(case.value - step)) / (2.0 * step)
    np.testing.assert_allclose(gradient, difference, rtol=DIFFERENCE)


LOAD = """
import sys, jax, numpy as np
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp, jaxscp as js
file, arrays = sys.argv[1:]
with np.load(arrays) as stored:
    numbers = {name[2:]: jnp.asarray(stored[name]) for name in stored if name[:2] == "p:"}
    guess = js.Trajectory(*(jnp.asarray(stored["g:" + part]) for part in ("time", "state", "control", "dilation")))
solution = js.load(file)(numbers, guess)
try:
    solution.trajectory.at(0.0)
except ValueError as error:  # dynamics of the user's
    assert "trajectory.with_dynamics(problem.dynamics)" in str(error), error
assert "tests.support.own_problems" not in sys.modules
print(js.status_names(solution.status), repr(float(solution.cost)))
"""


def saved(path, problem, guess):
    numbers = {f"p:{name}": np.asarray(value) for name, value in problem.arrays().items()}
    parts = {
        f"g:{part}": np.asarray(getattr(guess, part)) for part in ("time", "state", "control", "dilation")
    }
    np.savez(path, allow_pickle=False, **numbers, **parts)
    return path


@pytest.mark.nightly
@EVERY_CASE
def test_file_without_the_users_code(name, tmp_path):
    """Export, load in a fresh process, same answer."""
    _, problem, guess = request_of(name)
    js.Solver().export(tmp_path / "own.jaxscp", problem, guess)
    arrays = saved(tmp_path / "arrays.npz", problem, guess)
    command = [sys.executable, "-c", LOAD, str(tmp_path / "own.jaxscp"), str(arrays)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    status, cost = ran.stdout.split()
    assert status == "converged"
    assert float(cost) == float(js.solve(problem, guess).cost)


def steered(x, u, t, p):
    """A mass under a force, and an angle under its rate."""
    return jnp.stack([x[1], u[0] / 1000.0, u[1]])


def beside(x, u, t, most):
    return jnp.concatenate([most - u, most + u])


@pytest.mark.slow
@pytest.mark.parametrize("most", [2e4, 1e6])
@pytest.mark.parametrize("how", ["bounds", "rows", "with a scale"])
def test_limits_of_very_different_size_in_one_constraint_hold(how, most):
    """The angle moves by 3 at 0.2 a second, 15 s, while the force could end its part in a fraction of a second."""
    limits = np.array([most, 0.2])
    scale = js.Scale([1.0, 1.0, 1.0], limits, time=10.0, cost=1.0) if how == "with a scale" else None
    rows = js.Constraint(beside, js.NonNegative(), jnp.asarray(limits), convex=True)
    problem = js.OptimalControlProblem(
        dynamics=js.Dynamics.of(steered, states=3, controls=2),
        cost=js.Cost(terminal=lambda x, t, p: t),
        constraints=(rows if how == "rows" else js.bounds(control=(-limits, limits)),),
        boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([1.0, 0.0, 3.0])),
        time=js.Time(nodes=20, final=js.FreeTime(1.0, 100.0)),
        scale=scale,
    )
    solution = js.solve(problem, js.straight_line(problem, final_time=20.0))
    assert js.status_names(solution.status) == "converged"
    np.testing.assert_allclose(solution.final_time, 15.0, rtol=1e-4)
    assert float(jnp.max(jnp.abs(solution.trajectory.control[:, 1]))) <= 0.2 * (1.0 + 1e-4)
