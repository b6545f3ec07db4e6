"""Intervals to integrate over, their data, and their outputs."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.integration import tableaus


class OutputGroup(eqx.Module):
    """Consecutive rows of the path outputs that have the same margin function.

    Args:
        rows: number of rows.
        group_size: rows that share a margin: one, or all.
        subtract_margin: (values (points, group_size), margin mask (points,)) -> values less a margin for their
            decrease between points.
    """

    rows: int = eqx.field(static=True)
    group_size: int = eqx.field(static=True)
    subtract_margin: Callable[..., Array] = eqx.field(static=True)


class _NoRows(eqx.Module):
    def __call__(self, *_: Any) -> Float[Array, "0"]:
        return jnp.zeros(0)


class PathOutputs(eqx.Module):
    """Outputs of an interval besides its end state and cost.

    Args:
        at_point: (state, controls, data) -> rows, at every point; a pytree.
        at_ends: (w, data) -> rows, functions of the interval's own variables; a pytree.
        groups: groups of the rows of ``at_point``.
    """

    at_point: Callable[..., Array] = _NoRows()
    at_ends: Callable[..., Array] = _NoRows()
    groups: tuple[OutputGroup, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there are no such outputs."""
        return not self.groups and isinstance(self.at_ends, _NoRows)


class Intervals(eqx.Module):
    """Right-hand side, integration method and outputs, the same for every interval.

    An interval's variables are w = (state, first controls, last controls); controls are linear between. Time within an
    interval runs from 0 to 1.

    Args:
        rate: (state, controls) -> time derivative of the state, and after it of the running cost; a pytree.
        states: size of the state.
        method: Butcher tableau.
        steps: Runge-Kutta steps of an interval.
        steps_per_subinterval: steps between two points at which outputs are evaluated.
        path_outputs: outputs besides end state and cost.
    """

    rate: Callable[..., Array]
    states: int = eqx.field(static=True)
    method: tableaus.Method = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    steps_per_subinterval: int = eqx.field(static=True)
    path_outputs: PathOutputs = PathOutputs()

    def __check_init__(self):
        if self.steps % self.steps_per_subinterval:
            raise ValueError(
                f"steps_per_subinterval: {self.steps} steps are no multiple of {self.steps_per_subinterval}"
            )

    @property
    def points(self) -> int:
        """Number of points of an interval, its ends included."""
        return self.steps // self.steps_per_subinterval + 1

    def controls(self, inputs: int) -> int:
        """Number of controls, from the size of w."""
        return (inputs - self.states) // 2


class IntervalData(eqx.Module):
    """Data of one interval; of several, with intervals as the leading axis."""

    point: Any
    """Argument of ``PathOutputs.at_point``."""
    ends: Any
    """Argument of ``PathOutputs.at_ends``."""
    margin_mask: Float[Array, "*intervals points"]
    """1 where a margin is subtracted, else 0."""


class IntervalOutputs(eqx.Module):
    """Outputs of one interval; of several, with intervals as the leading axis. Of Jacobians, w is the last axis."""

    end: Float[Array, "..."]
    """(states,): state at the end."""
    cost: Float[Array, "..."]
    """(): running cost."""
    points: tuple[Float[Array, "..."], ...]
    """(points, rows) for each group, less its margin."""
    ends: Float[Array, "..."]
    """(rows,): functions of w."""


def without_data(intervals: Intervals, count: int) -> IntervalData:
    """Data of so many intervals without path outputs."""
    return IntervalData((), (), jnp.zeros((count, intervals.points)))


def controls_at(
    w: Float[Array, "inputs"], states: int, fraction: Float[Array, "*b"]
) -> Float[Array, "*b controls"]:
    """Controls at fractions of an interval, interpolated linearly between its ends."""
    first, last = jnp.split(w[states:], 2)
    return first + fraction[..., None] * (last - first)


def outputs_of_path(
    intervals: Intervals, w: Float[Array, "inputs"], path: Float[Array, "after extended"], data: IntervalData
) -> IntervalOutputs:
    """Outputs of one interval.

    Args:
        intervals: the integration.
        w: the interval's variables.
        path: state and running cost at every point but the first.
        data: the interval's data.
    """
    n, path_outputs = intervals.states, intervals.path_outputs
    states = jnp.concatenate([w[None, :n], path[:, :n]])
    controls = controls_at(w, n, jnp.linspace(0.0, 1.0, intervals.points, dtype=w.dtype))
    rows = jax.vmap(lambda x, u: path_outputs.at_point(x, u, data.point))(states, controls)
    parts, before = [], 0
    for group in path_outputs.groups:
        values = rows[:, before : before + group.rows].reshape(intervals.points, -1, group.group_size)
        values = jax.vmap(group.subtract_margin, in_axes=(1, None), out_axes=1)(values, data.margin_mask)
        parts.append(values.reshape(intervals.points, group.rows))
        before += group.rows
    return IntervalOutputs(path[-1, :n], path[-1, n], tuple(parts), path_outputs.at_ends(w, data.ends))
