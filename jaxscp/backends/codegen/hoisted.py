"""Hoisted constants of a kernel that is written from tapes: values that depend on no argument."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends.codegen import cuda_text, evaluate_tape
from jaxscp.backends.codegen.functions import TapedFunction


def hoisted_constants(function: TapedFunction, orders: Sequence[int] = (0,)) -> Float[Array, "hoisted"]:
    """Hoisted constants of a function's tapes, in the order in which a kernel reads them.

    Args:
        function: the function.
        orders: indices of the tapes: 0 for values and Jacobian, 1 for the Hessian.
    """
    found = [v for order in orders for v in _of_tape(function, order)]
    return jnp.stack(found) if found else jnp.zeros(0)


def _of_tape(function: TapedFunction, order: int) -> Sequence[Array]:
    tape = (function.first, function.second)[order]
    slots = cuda_text.hoisted_slots(tape, function.inputs)
    hoisted_tape = tape._replace(
        operations=tape.operations[: tape.hoisted_count], outputs=np.array(slots, int)
    )
    unread = [jnp.zeros(())] * function.inputs  # no hoisted operation reads an input
    return evaluate_tape.evaluate(hoisted_tape, unread, function.parameters[order])
