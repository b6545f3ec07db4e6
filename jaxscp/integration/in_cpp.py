"""The pass in C++, for float64 on a CPU: what is particular to a problem by tapes, the rest as written there.

XLA runs the derivatives of an interval as thousands of small operations on arrays that are mostly zero. Here the zeros
are known before, and two registers of intervals go through each operation.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends import libraries
from jaxscp.backends.codegen import functions, tape
from jaxscp.backends.codegen.functions import Function
from jaxscp.integration import native
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals
from jaxscp.integration.rate_tape import record_slopes


class Functions(NamedTuple):
    """All that is particular to a problem."""

    rate: Function
    point: Function
    ends: Function
    margins: tuple[Function, ...]
    """By block: of all its values that have a margin in common."""


def serves(w: Array) -> bool:
    """Whether it goes through intervals of these variables."""
    return libraries.in_float64(w) and native.LIBRARY.available()


def record(intervals: Intervals, inputs: int, given: IntervalData, order: int) -> Functions:
    """Find the operations for a pass with derivatives up to an order.

    Raises:
        CannotTrace: if they are not arithmetic alone.
    """
    n, points, watch = intervals.states, intervals.points, intervals.watch
    of_point, point_tree = jax.tree.flatten(jax.tree.map(lambda v: v[0], given.point))
    of_ends, ends_tree = jax.tree.flatten(jax.tree.map(lambda v: v[0], given.ends))
    argument = n + intervals.controls(inputs)

    def margin(block):
        def function(values, keep):
            return jnp.ravel(block.less_margin(values.reshape(points, block.together), keep))

        return functions.record(function, points * block.together, [given.keep[0]], order)

    return Functions(
        record_slopes(intervals, inputs, order),
        functions.record(
            lambda a, *data: watch.at_point(a[:n], a[n:], jax.tree.unflatten(point_tree, data)),
            argument,
            of_point,
            order,
        ),
        functions.record(
            lambda a, *data: watch.of_ends(a, jax.tree.unflatten(ends_tree, data)), inputs, of_ends, order
        ),
        tuple(map(margin, watch.blocks)),
    )


def first_inputs(jacobian: np.ndarray, states: int, inputs: int) -> np.ndarray:
    """By row of the path, the first of an interval's inputs that it can depend on; all after it count as such."""
    first = np.array([*range(states), inputs])
    for _ in range(states + 1):
        for row, column in jacobian:
            first[row] = min(first[row], first[column] if column < states else column)
    return first.astype(np.int32)


class _Description:
    """Lists of numbers, which ``native/description.h`` reads in the order in which they are written."""

    def __init__(self) -> None:
        self.whole: list[np.ndarray] = []
        self.real: list[np.ndarray] = []

    def numbers(self, *values: int) -> None:
        self.whole.append(np.array(values, np.int32))

    def several(self, values: np.ndarray) -> None:
        self.numbers(len(values))
        self.whole.append(np.ravel(values).astype(np.int32))

    def reals(self, values: np.ndarray) -> None:
        self.numbers(values.size)
        self.real.append(np.ravel(values).astype(float))

    def tape(self, t: tape.Tape) -> None:
        self.several(t.operations)
        self.numbers(t.hoisted, t.places, len(t.parameters))
        self.reals(t.constants)
        self.several(t.outputs)

    def function(self, f: Function) -> None:
        self.numbers(f.arguments, f.values, f.data)
        self.tape(f.first)
        self.tape(f.second)
        self.several(f.jacobian)
        self.several(f.hessian)


def _described(intervals: Intervals, found: Functions, inputs: int, order: int) -> dict[str, np.ndarray]:
    to, method = _Description(), intervals.method
    to.numbers(order, intervals.states, intervals.controls(inputs), intervals.steps, intervals.every)
    for table in (method.shares, method.weights, method.table):
        to.reals(table)
    to.several(first_inputs(found.rate.jacobian, intervals.states, inputs))
    for function in found[:3]:
        to.function(function)
    to.numbers(len(found.margins))
    for block, margin in zip(intervals.watch.blocks, found.margins, strict=True):
        to.numbers(block.rows, block.together)
        to.function(margin)
    return {"whole": np.concatenate(to.whole), "real": np.concatenate(to.real)}


def sweep(
    intervals: Intervals,
    found: Functions,
    w: Float[Array, "intervals inputs"],
    given: IntervalData,
    prices: IntervalOutputs | None,
    order: int,
) -> tuple[Any, ...]:
    """The outcomes, their Jacobian, and the curvature of their priced sum, up to an order; with operations already
    found."""
    count, inputs = w.shape
    of_blocks = [intervals.points * block.rows for block in intervals.watch.blocks]
    widths = [intervals.states, 1, *of_blocks, found.ends.values]
    shapes = [(sum(widths),), (sum(widths), inputs), (inputs, inputs)][: order + 1]
    all_functions = [*found[:3], *found.margins]
    parameters = [f.parameters[which] for which in (0, 1) for f in all_functions]
    arrays = [w, jnp.concatenate(parameters), _side_by_side(given)]
    if order == 2:
        arrays.append(_side_by_side(prices))
    call = jax.ffi.ffi_call(
        native.TARGET,
        [jax.ShapeDtypeStruct((count, *shape), w.dtype) for shape in shapes],
        vmap_method="broadcast_all",
    )
    outcomes, *rest = call(*arrays, **_described(intervals, found, inputs, order))
    ends = np.cumsum(widths)[:-1]

    def split(flat: Array) -> IntervalOutputs:
        end, cost, *points, of_ends = jnp.split(flat, ends, axis=1)
        shaped = [p.reshape(count, intervals.points, -1, *flat.shape[2:]) for p in points]
        return IntervalOutputs(end, cost[:, 0], tuple(shaped), of_ends)

    return (split(outcomes), *map(split, rest[:1]), *rest[1:])


def _side_by_side(tree: Any) -> Float[Array, "intervals numbers"]:
    """All that there is of each interval."""
    leaves = jax.tree.leaves(tree)
    return jnp.concatenate([v.reshape(v.shape[0], math.prod(v.shape[1:])) for v in leaves], axis=1)
