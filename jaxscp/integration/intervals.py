"""What a pass goes through, and what it finds."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.integration import tableaus


class OutputGroup(eqx.Module):
    """Some of the rows that are watched at the points of an interval.

    Args:
        rows: how many.
        together: how many of them have a margin in common: one, or all.
        less_margin: (values (points, together), where it is kept (points,)) -> the values, less what they may lack
            between the points.
    """

    rows: int = eqx.field(static=True)
    together: int = eqx.field(static=True)
    less_margin: Callable[..., Array] = eqx.field(static=True)


class _Nothing(eqx.Module):
    def __call__(self, *_: Any) -> Float[Array, "0"]:
        return jnp.zeros(0)


class PathOutputs(eqx.Module):
    """What is asked of an interval besides its end.

    Args:
        at_point: (state, controls, data) -> rows, at every point; a pytree.
        of_ends: (w, data) -> rows, of the interval's own variables; a pytree.
        blocks: the rows of ``at_point``.
    """

    at_point: Callable[..., Array] = _Nothing()
    of_ends: Callable[..., Array] = _Nothing()
    blocks: tuple[OutputGroup, ...] = ()

    @property
    def nothing(self) -> bool:
        """Whether nothing is asked."""
        return not self.blocks and isinstance(self.of_ends, _Nothing)


class Intervals(eqx.Module):
    """What a pass goes through, and how.

    An interval's variables are w = (state, first controls, last controls); controls are linear between.

    Args:
        rate: (state, controls) -> slope of the state by the share of the interval, and of a cost after it; a pytree.
        states: how many.
        method: of integration.
        steps: of an interval.
        every: how many steps there are between two points.
        watch: what else is asked.
    """

    rate: Callable[..., Array]
    states: int = eqx.field(static=True)
    method: tableaus.Method = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    every: int = eqx.field(static=True)
    watch: PathOutputs = PathOutputs()

    def __check_init__(self):
        if self.steps % self.every:
            raise ValueError(f"every: {self.steps} steps are no multiple of {self.every}")

    @property
    def points(self) -> int:
        """Of an interval, its ends included."""
        return self.steps // self.every + 1

    def controls(self, inputs: int) -> int:
        """How many there are at one end, of so many variables."""
        return (inputs - self.states) // 2


class IntervalData(eqx.Module):
    """Data of intervals, which are the leading axis if there are many."""

    point: Any
    """For ``PathOutputs.at_point``."""
    ends: Any
    """For ``PathOutputs.of_ends``."""
    keep: Float[Array, "*intervals points"]
    """Where a margin is kept: one, or zero."""


class IntervalOutputs(eqx.Module):
    """What intervals give, the intervals as leading axis if there are many; in Jacobians inputs are the last axis."""

    end: Float[Array, "..."]
    """(states,)"""
    cost: Float[Array, "..."]
    """()"""
    points: tuple[Float[Array, "..."], ...]
    """(points, rows) of every block, less its margin."""
    ends: Float[Array, "..."]
    """(rows,)"""


def without_data(intervals: Intervals, count: int) -> IntervalData:
    """Of intervals that nothing else is asked of."""
    return IntervalData((), (), jnp.zeros((count, intervals.points)))


def controls_at(
    w: Float[Array, "inputs"], states: int, share: Float[Array, "*b"]
) -> Float[Array, "*b controls"]:
    """Controls at shares of an interval, linear between those at its ends."""
    first, last = jnp.split(w[states:], 2)
    return first + share[..., None] * (last - first)


def outcome(
    intervals: Intervals, w: Float[Array, "inputs"], path: Float[Array, "after extended"], given: IntervalData
) -> IntervalOutputs:
    """What an interval gives, from the state and the cost so far at every point but the first."""
    n, watch = intervals.states, intervals.watch
    states = jnp.concatenate([w[None, :n], path[:, :n]])
    controls = controls_at(w, n, jnp.linspace(0.0, 1.0, intervals.points, dtype=w.dtype))
    rows = jax.vmap(lambda x, u: watch.at_point(x, u, given.point))(states, controls)
    parts, before = [], 0
    for block in watch.blocks:
        values = rows[:, before : before + block.rows].reshape(intervals.points, -1, block.together)
        values = jax.vmap(block.less_margin, in_axes=(1, None), out_axes=1)(values, given.keep)
        parts.append(values.reshape(intervals.points, block.rows))
        before += block.rows
    return IntervalOutputs(path[-1, :n], path[-1, n], tuple(parts), watch.of_ends(w, given.ends))
