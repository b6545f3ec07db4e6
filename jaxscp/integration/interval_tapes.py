"""Functions of intervals as tapes, and the flat arrays that compiled implementations read and write."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.backends.codegen import functions
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals, OutputGroup
from jaxscp.integration.rate_tape import record_rate


class IntervalTapes(NamedTuple):
    """Functions of a problem as tapes."""

    rate: TapedFunction
    point: TapedFunction
    ends: TapedFunction
    margins: tuple[TapedFunction, ...]
    """``subtract_margin`` of each output group, a function of the values that share a margin."""


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

    return IntervalTapes(
        record_rate(intervals, inputs, order),
        functions.record(
            _AtPoint(outputs.at_point, n, point_tree), n + intervals.controls(inputs), of_point, order
        ),
        functions.record(_AtEnds(outputs.at_ends, ends_tree), inputs, of_ends, order),
        tuple(
            functions.record(_Margin(group, points), points * group.group_size, [data.margin_mask[0]], order)
            for group in outputs.groups
        ),
    )


class _AtPoint(eqx.Module):
    function: Callable[..., Array]
    states: int = eqx.field(static=True)
    data: Any = eqx.field(static=True)

    def __call__(self, a: Array, *data: Array) -> Array:
        return self.function(a[: self.states], a[self.states :], jax.tree.unflatten(self.data, data))


class _AtEnds(eqx.Module):
    function: Callable[..., Array]
    data: Any = eqx.field(static=True)

    def __call__(self, w: Array, *data: Array) -> Array:
        return self.function(w, jax.tree.unflatten(self.data, data))


class _Margin(eqx.Module):
    group: OutputGroup
    points: int = eqx.field(static=True)

    def __call__(self, values: Array, mask: Array) -> Array:
        return jnp.ravel(self.group.subtract_margin(values.reshape(self.points, self.group.group_size), mask))


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


def flat_shapes(intervals: Intervals, tapes: IntervalTapes, inputs: int) -> list[tuple[int, ...]]:
    """Shapes of an interval's outputs side by side, of their Jacobian, and of the Hessian."""
    rows = sum(_widths(intervals, tapes))
    return [(rows,), (rows, inputs), (inputs, inputs)]


def in_parts(intervals: Intervals, tapes: IntervalTapes, found: Sequence[Array]) -> tuple[Any, ...]:
    """Outputs and their Jacobian in parts; the Hessian as it is.

    Args:
        intervals: the integration.
        tapes: its functions.
        found: arrays with ``flat_shapes``, intervals as the leading axis; the first one or more.
    """
    splits = np.cumsum(_widths(intervals, tapes))[:-1]

    def split(flat: Array) -> IntervalOutputs:
        end, cost, *points, ends = jnp.split(flat, splits, axis=1)
        shaped = [p.reshape(flat.shape[0], intervals.points, -1, *flat.shape[2:]) for p in points]
        return IntervalOutputs(end, cost[:, 0], tuple(shaped), ends)

    return (*map(split, found[:2]), *found[2:])


def _widths(intervals: Intervals, tapes: IntervalTapes) -> list[int]:
    of_groups = [intervals.points * group.rows for group in intervals.path_outputs.groups]
    return [intervals.states, 1, *of_groups, tapes.ends.values]


def side_by_side(tree: Any) -> Float[Array, "intervals numbers"]:
    """All leaves of a pytree as one row for each interval."""
    leaves = jax.tree.leaves(tree)
    return jnp.concatenate([v.reshape(v.shape[0], math.prod(v.shape[1:])) for v in leaves], axis=1)
