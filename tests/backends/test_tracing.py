"""Functions that are not arithmetic alone."""

import jax
import jax.numpy as jnp
import pytest

from jaxscp.backends.codegen import tracing


def test_an_operation_without_tape_code_is_named_in_the_error():
    with pytest.raises(tracing.CannotTrace, match="erf"):
        tracing.trace(lambda v: jax.scipy.special.erf(v), (2,))


def test_a_long_chain_before_an_operation_that_no_tape_has():
    """Values of hoisted arrays are computed when they are needed, one after the other."""

    @jax.jit
    def traced(p):
        def function(x):
            q = p
            for _ in range(400):
                q = q + 1.0
            return x * jnp.sort(q)

        return tracing.trace(function, (2,)).hoisted[-1]

    assert traced(jnp.array([2.0, 1.0])).tolist() == [401.0, 402.0]
