"""The gallery: each example reaches its reference; batches and gradients agree with single calls."""

import ast
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from examples import GALLERY, default_number, example

SAME = 1e-8  # relative: a batch and single calls end at the same optimum, to the interior point's tolerance
DIFFERENCE = 1e-4  # relative: a gradient against central differences
STEP = 1e-3  # of differences, relative to the number
BATCH = 16
MOST_LINES = 25

# Each compiles for more than a few seconds; ``test_own_problems`` has problems like those that run by night.
MARKS = {"minimum_energy": (pytest.mark.slow,)}
BY_NIGHT = pytest.mark.nightly
EVERY = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=MARKS.get(name, BY_NIGHT)) for name in GALLERY]
)
NIGHTLY = pytest.mark.parametrize("name", [pytest.param(name, marks=BY_NIGHT) for name in GALLERY])


def solved(module, number, guess):
    return js.solve(module.problem(number), guess)


def request_of(name):
    module = example(name)
    return module, default_number(module), module.guess(module.problem())


@EVERY
def test_example_reaches_its_reference(name):
    module, number, guess = request_of(name)
    solution = solved(module, number, guess)
    assert js.status_names(solution.status) == "converged"
    assert bool(solution.certificate.passed())
    np.testing.assert_allclose(solution.cost, module.REFERENCE.value, rtol=module.REFERENCE.tolerance)
    assert module.draw(solution).axes


def from_the_optimum(name):
    """A request that starts at the optimum: from elsewhere, neighbouring problems may end at other local optima."""
    module, number, guess = request_of(name)
    return module, number, solved(module, number, guess)


@NIGHTLY
def test_batch_equals_single_calls(name):
    module, number, guess = from_the_optimum(name)
    numbers = number * np.linspace(0.97, 1.03, BATCH)
    batch = jax.vmap(lambda v: solved(module, v, guess))(jnp.asarray(numbers))
    singles = [solved(module, float(v), guess) for v in numbers]
    assert set(js.status_names(batch.status)) == {"converged"}
    np.testing.assert_allclose(batch.cost, [float(s.cost) for s in singles], rtol=SAME)


@NIGHTLY
def test_gradient_agrees_with_differences(name):
    module, number, guess = from_the_optimum(name)
    cost = lambda v: solved(module, v, guess).cost  # noqa: E731
    gradient, step = jax.grad(cost)(number), STEP * number
    difference = (cost(number + step) - cost(number - step)) / (2.0 * step)
    np.testing.assert_allclose(gradient, difference, rtol=DIFFERENCE)


@pytest.mark.parametrize("name", GALLERY)
def test_example_is_short(name):
    """Lines of code before the reference, without imports, comments and the module's docstring."""
    source = inspect.getsource(example(name)).split("# --- what to expect ---")[0]
    body = [node for node in ast.parse(source).body[1:] if not isinstance(node, ast.Import | ast.ImportFrom)]
    lines = {n for node in body for n in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    text = source.splitlines()
    assert sum(bool(text[n - 1].split("#")[0].strip()) for n in lines) <= MOST_LINES
