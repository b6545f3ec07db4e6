"""Tapes: order of the operations, and common subexpressions."""

import itertools

import jax.numpy as jnp
import numpy as np

from jaxscp.backends.codegen import tape, tracing
from jaxscp.backends.codegen.evaluate_tape import evaluate

ROUNDING = 1e-12


def recorded(function):
    """Tape of a function of a vector of three."""
    (outputs,) = tracing.trace(function, (3,)).outputs
    return tape.record(list(outputs), 3)


def test_equal_operations_form_runs_and_follow_their_operands():
    def function(v):
        return jnp.stack([v[0] * v[1] - v[2], (v[0] - v[1]) * v[2], (v[1] - v[2]) * v[0] * v[0]])

    found = recorded(function)
    codes = [int(code) for code in found.operations[:, 0]]
    runs = 1 + sum(a != b for a, b in itertools.pairwise(codes))
    assert runs <= 3
    v = [jnp.array(x) for x in (1.1, 0.3, -2.0)]
    np.testing.assert_allclose(evaluate(found, v, jnp.zeros(0)), function(jnp.stack(v)), rtol=ROUNDING)


def test_equal_expressions_are_recorded_once():
    found = recorded(lambda v: jnp.stack([v[0] * v[1] + v[2], v[1] * v[0] - v[2], 0.0 * v[0], v[2] * 1.0]))
    assert len(found.operations) == 3  # the product has two readers, so that neither absorbs it
    assert found.outputs[3] == 2
    assert list(found.constants) == [0.0]
