"""Integration in C++, for float64 on a CPU. Tapes describe the functions of a problem, the C++ all else.

XLA runs an interval's derivatives as thousands of small operations on mostly zero arrays. Tapes contain no zeros, and
each of their operations takes two registers of intervals at once.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import tape
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration import native
from jaxscp.integration.interval_tapes import IntervalTapes, first_inputs, flat_shapes, in_parts, side_by_side
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals


def supports(w: Array) -> bool:
    """Whether the C++ can integrate intervals of these variables."""
    return libraries.in_float64(w) and native.LIBRARY.available()


class _Writer:
    """Serialiser: two flat arrays, which ``native/description.h`` reads in the same order."""

    def __init__(self) -> None:
        self.integers: list[np.ndarray] = []
        self.reals: list[np.ndarray] = []

    def write(self, *values: int) -> None:
        self.integers.append(np.array(values, np.int32))

    def write_integers(self, values: np.ndarray) -> None:
        self.write(len(values))
        self.integers.append(np.ravel(values).astype(np.int32))

    def write_reals(self, values: np.ndarray) -> None:
        self.write(values.size)
        self.reals.append(np.ravel(values).astype(float))

    def write_tape(self, t: tape.Tape) -> None:
        self.write_integers(t.operations)
        self.write(t.hoisted_count, t.slots, len(t.parameters))
        self.write_reals(t.constants)
        self.write_integers(t.outputs)

    def write_function(self, f: TapedFunction) -> None:
        self.write(f.arguments, f.values, f.data)
        self.write_tape(f.first)
        self.write_tape(f.second)
        self.write_integers(f.jacobian)
        self.write_integers(f.hessian)


def _description(
    intervals: Intervals, tapes: IntervalTapes, inputs: int, order: int
) -> dict[str, np.ndarray]:
    """FFI attributes that describe the integration."""
    to, method = _Writer(), intervals.method
    to.write(
        order,
        intervals.states,
        intervals.controls(inputs),
        intervals.steps,
        intervals.steps_per_subinterval,
    )
    for coefficients in (method.c, method.b, method.a):
        to.write_reals(coefficients)
    to.write_integers(first_inputs(tapes.rate.jacobian, intervals.states, inputs))
    for function in tapes[:3]:
        to.write_function(function)
    to.write(len(tapes.margins))
    for group, margin in zip(intervals.path_outputs.groups, tapes.margins, strict=True):
        to.write(group.rows, group.group_size)
        to.write_function(margin)
    return {"integers": np.concatenate(to.integers), "reals": np.concatenate(to.reals)}


def integrate(
    intervals: Intervals,
    tapes: IntervalTapes,
    w: Float[Array, "intervals inputs"],
    data: IntervalData,
    multipliers: IntervalOutputs | None,
    order: int,
) -> tuple[Any, ...]:
    """Outputs; from order 1 their Jacobian; of order 2 the Hessian of their sum weighted by the multipliers.

    Args:
        intervals: the integration.
        tapes: its functions, recorded up to the same order.
        w: variables of every interval.
        data: data of every interval.
        multipliers: weights of the outputs; read for order 2.
        order: highest derivative.
    """
    count, inputs = w.shape
    shapes = flat_shapes(intervals, tapes, inputs)[: order + 1]
    all_functions = [*tapes[:3], *tapes.margins]
    parameters = [f.parameters[which] for which in (0, 1) for f in all_functions]
    arrays = [w, jnp.concatenate(parameters), side_by_side(data)]
    if order == 2:
        arrays.append(side_by_side(multipliers))
    call = jax.ffi.ffi_call(
        native.TARGET,
        [jax.ShapeDtypeStruct((count, *shape), w.dtype) for shape in shapes],
        vmap_method="broadcast_all",
    )
    found = call(*arrays, **_description(intervals, tapes, inputs, order))
    return in_parts(intervals, tapes, found)
