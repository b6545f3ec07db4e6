"""Hoisted constants of a kernel that is written from tapes: values that depend on no argument."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends.codegen import cuda_text, evaluate_tape
from jaxscp.backends.codegen.functions import TapedFunction


def hoisted_constants(function: TapedFunction) -> Float[Array, "hoisted"]:
    """Hoisted constants of a function's tapes, in the order in which a kernel reads them; of the first tape, first."""
    unread = [jnp.zeros(())] * function.inputs  # no hoisted operation reads an input
    found: list[Array] = []
    for tape, parameters in zip((function.first, function.second), function.parameters, strict=True):
        slots = np.array(cuda_text.hoisted_slots(tape, function.inputs), int)
        hoisted = tape._replace(operations=tape.operations[: tape.hoisted_count], outputs=slots)
        found += evaluate_tape.evaluate(hoisted, unread, parameters)
    return jnp.stack(found) if found else jnp.zeros(0)
