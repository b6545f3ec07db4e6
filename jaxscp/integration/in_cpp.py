"""Integration in C++, for float64 on a CPU. Tapes describe the functions of a problem, the C++ all else.

XLA runs an interval's derivatives as thousands of small operations on mostly zero arrays. Tapes contain no zeros, and
each of their operations takes two registers of intervals at once.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import functions, tape
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration import native
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals, OutputGroup
from jaxscp.integration.rate_tape import record_rate


class IntervalTapes(NamedTuple):
    """Functions of a problem as tapes."""

    rate: TapedFunction
    point: TapedFunction
    ends: TapedFunction
    margins: tuple[TapedFunction, ...]
    """``subtract_margin`` of each output group, a function of the values that share a margin."""


def supports(w: Array) -> bool:
    """Whether the C++ can integrate intervals of these variables."""
    return libraries.in_float64(w) and native.LIBRARY.available()


def record(intervals: Intervals, inputs: int, data: IntervalData, order: int) -> IntervalTapes:
    """Tapes of all functions, with derivatives up to an order.

    Args:
        intervals: the integration.
        inputs: size of w.
        data: data of all intervals, for their shapes.
        order: highest derivative.

    Raises:
        CannotTrace: if a function is not arithmetic alone.
    """
    n, points, outputs = intervals.states, intervals.points, intervals.path_outputs
    of_point, point_tree = jax.tree.flatten(jax.tree.map(lambda v: v[0], data.point))
    of_ends, ends_tree = jax.tree.flatten(jax.tree.map(lambda v: v[0], data.ends))

    def at_point(a, *data):
        return outputs.at_point(a[:n], a[n:], jax.tree.unflatten(point_tree, data))

    def at_ends(w, *data):
        return outputs.at_ends(w, jax.tree.unflatten(ends_tree, data))

    def margin(group: OutputGroup):
        def function(values, mask):
            return jnp.ravel(group.subtract_margin(values.reshape(points, group.group_size), mask))

        return functions.record(function, points * group.group_size, [data.margin_mask[0]], order)

    return IntervalTapes(
        record_rate(intervals, inputs, order),
        functions.record(at_point, n + intervals.controls(inputs), of_point, order),
        functions.record(at_ends, inputs, of_ends, order),
        tuple(map(margin, outputs.groups)),
    )


def first_inputs(jacobian: np.ndarray, states: int, inputs: int) -> np.ndarray:
    """First entry of w that each row of the path can depend on; all later entries count as nonzero, too.

    Args:
        jacobian: (entries, 2), nonzero entries of the rate's Jacobian.
        states: size of the state.
        inputs: size of w.
    """
    first = np.array([*range(states), inputs])
    for _ in range(states + 1):
        for row, column in jacobian:
            first[row] = min(first[row], first[column] if column < states else column)
    return first.astype(np.int32)


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
    of_groups = [intervals.points * group.rows for group in intervals.path_outputs.groups]
    widths = [intervals.states, 1, *of_groups, tapes.ends.values]
    shapes = [(sum(widths),), (sum(widths), inputs), (inputs, inputs)][: order + 1]
    all_functions = [*tapes[:3], *tapes.margins]
    parameters = [f.parameters[which] for which in (0, 1) for f in all_functions]
    arrays = [w, jnp.concatenate(parameters), _side_by_side(data)]
    if order == 2:
        arrays.append(_side_by_side(multipliers))
    call = jax.ffi.ffi_call(
        native.TARGET,
        [jax.ShapeDtypeStruct((count, *shape), w.dtype) for shape in shapes],
        vmap_method="broadcast_all",
    )
    outputs, *derivatives = call(*arrays, **_description(intervals, tapes, inputs, order))
    splits = np.cumsum(widths)[:-1]

    def split(flat: Array) -> IntervalOutputs:
        end, cost, *points, ends = jnp.split(flat, splits, axis=1)
        shaped = [p.reshape(count, intervals.points, -1, *flat.shape[2:]) for p in points]
        return IntervalOutputs(end, cost[:, 0], tuple(shaped), ends)

    return (split(outputs), *map(split, derivatives[:1]), *derivatives[1:])


def _side_by_side(tree: Any) -> Float[Array, "intervals numbers"]:
    """All leaves of a pytree as one row for each interval."""
    leaves = jax.tree.leaves(tree)
    return jnp.concatenate([v.reshape(v.shape[0], math.prod(v.shape[1:])) for v in leaves], axis=1)
