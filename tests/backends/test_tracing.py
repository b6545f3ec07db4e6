"""Functions that are not arithmetic alone."""

import jax
import pytest

from jaxscp.backends.codegen import tracing


def test_an_operation_without_tape_code_is_named_in_the_error():
    with pytest.raises(tracing.CannotTrace, match="erf"):
        tracing.trace(lambda v: jax.scipy.special.erf(v), (2,))
