"""One interval of the flight as a function of its own variables: where it ends, what it costs, how safe it is.

An interval's variables are w = (x_i, U_i, U_{i+1}): the state at its first node, and controls with their dilation
at both. Path constraints hold at equally spaced points of every interval, its ends included, and between those
points by a margin: where a value's second difference over three points is d, the value dips below the chord by
d / 8 at most (to fourth order), so that much, and a tenth more, is asked for at the points.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.cones.cone import SecondOrder
from jaxscp.integration import dispatch, tableaus
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals, OutputGroup, PathOutputs
from jaxscp.problem.constraint import AcrossIntervals, Constraint, Throughout
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import Condition, OptimalControlProblem, linearised_ends
from jaxscp.transcription.layout import interval_inputs

METHOD = tableaus.SIXTH_ORDER
RESERVE = 1.1  # of the margin: a path may bend more between the points than at them
_KINK = 1e-4  # m, or a value's unit: rounds the corner of max(0, d); a sixteenth of it may be missed


class Grid(eqx.Module):
    """Where an interval is integrated and constrained.

    Args:
        points: stretches between the points at which constraints hold.
        steps: sixth-order Runge-Kutta steps of a stretch.
    """

    points: int = eqx.field(default=5, static=True)
    steps: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.points < 3 or self.steps < 1:
            raise ValueError(f"a grid needs 3 points and 1 step or more, not {self.points} and {self.steps}")

    @property
    def all_steps(self) -> int:
        """Runge-Kutta steps of an interval."""
        return self.points * self.steps


class Outputs(eqx.Module):
    """What intervals give, the intervals as leading axis if there are many; in Jacobians inputs are the last axis."""

    end: Float[Array, "..."]
    """(states,)"""
    cost: Float[Array, "..."]
    """(), the running cost."""
    values: tuple[Float[Array, "..."], ...]
    """(points, rows) of every constraint, less the margin; of those that do not hold throughout, at one point."""


class Linearisation(eqx.Module):
    """All that is linearised about a point."""

    outputs: Outputs
    jacobian: Outputs
    """With respect to w; the variables come last."""
    initial: Condition
    """At the start."""
    final: Condition
    """At the end."""


@eqx.filter_jit  # traced once for all calls of one program
def evaluate(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """Outputs of every interval."""
    found = dispatch.evaluate(intervals_of(problem, grid), interval_inputs(problem, z), given(problem, grid))
    return outputs(problem, found)


@eqx.filter_jit
def linearise(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid
) -> Linearisation:
    """Outputs of every interval and their Jacobians."""
    found = dispatch.linearise(intervals_of(problem, grid), interval_inputs(problem, z), given(problem, grid))
    return linearisation(problem, z, *found)


@eqx.filter_jit  # traced once for all calls of one program
def linearise_with_hessian(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> tuple[Linearisation, Float[Array, "intervals inputs inputs"]]:
    """Every interval linearised, and the second derivatives of the Lagrangian, a block an interval.

    Nothing couples intervals but linearly. What holds at nodes alone, the conditions at both ends and the terminal cost
    have second derivatives of their own, which are left out.
    """
    held = tuple(  # on the central path, what does not hold has a price all the same
        jnp.where(active_points(c, v.shape[1])[:, :, None], -v, 0.0)
        for c, v in zip(problem.constraints, y.by_interval(), strict=True)
    )
    asked = prices(problem, Outputs(y.flow, jnp.ones(problem.nodes - 1, z.dtype), held))
    intervals, w = intervals_of(problem, grid), interval_inputs(problem, z)
    found, jacobian, curvature = dispatch.linearise_with_hessian(intervals, w, given(problem, grid), asked)
    return linearisation(problem, z, found, jacobian), curvature


def linearisation(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    found: IntervalOutputs,
    jacobian: IntervalOutputs,
) -> Linearisation:
    """From what a pass found at z."""
    return Linearisation(outputs(problem, found), outputs(problem, jacobian), *linearised_ends(problem, z))


def intervals_of(problem: OptimalControlProblem, grid: Grid) -> Intervals:
    """What a pass through the intervals of a flight goes through."""
    asked = _Asked(problem)
    blocks = tuple(
        OutputGroup(rows, rows, _second_order_less_margin)
        if isinstance(c.cone, SecondOrder)
        else OutputGroup(rows, 1, _less_margin)
        for c, rows in zip(problem.constraints, _rows(problem), strict=True)
        if isinstance(c.where, Throughout)
    )
    watch = PathOutputs(asked.at_point, asked.of_ends, blocks)
    return Intervals(problem.slope, problem.state_size, METHOD, grid.all_steps, grid.steps, watch)


def given(problem: OptimalControlProblem, grid: Grid) -> IntervalData:
    """For every interval: each constraint's parameters at its first node, and where the margin is kept.

    The flight's two ends have none: there the boundary decides, and a goal may lie on the floor of its corridor.
    """
    parameters = [jax.tree.map(lambda p: p[:-1], c.parameters) for c in problem.constraints]
    keep = jnp.ones((problem.nodes - 1, grid.points + 1)).at[0, 0].set(0.0).at[-1, -1].set(0.0)
    return IntervalData(*_sorted(problem, parameters), keep)


def outputs(problem: OptimalControlProblem, found: IntervalOutputs) -> Outputs:
    """What a pass found (or its Jacobian), by constraints."""
    rows = [n for c, n in zip(problem.constraints, _rows(problem), strict=True) if not _throughout(c)]
    points, before, values = iter(found.points), 0, []
    for constraint in problem.constraints:
        if _throughout(constraint):
            values.append(next(points))
        else:
            count = rows.pop(0)
            values.append(found.ends[:, None, before : before + count])
            before += count
    return Outputs(found.end, found.cost, tuple(values))


def prices(problem: OptimalControlProblem, of: Outputs) -> IntervalOutputs:
    """The adjoint of ``outputs``: prices of what a pass finds, from those of every interval's outputs."""
    points, ends = _sorted(problem, of.values)
    flat = [v[:, 0] for v in ends]
    none = jnp.zeros((of.end.shape[0], 0), of.end.dtype)
    return IntervalOutputs(of.end, of.cost, points, jnp.concatenate([none, *flat], axis=1))


class _Asked(eqx.Module):
    """The constraints' values, side by side."""

    problem: OptimalControlProblem

    def at_point(self, state, control, parameters) -> Float[Array, "rows"]:
        """Of those that hold throughout."""
        held = filter(_throughout, self.problem.constraints)
        values = [value_at(self.problem, c, state, control, p) for c, p in zip(held, parameters, strict=True)]
        return jnp.concatenate([jnp.zeros(0, state.dtype), *values])

    def of_ends(self, w, parameters) -> Float[Array, "rows"]:
        """Of the others: at the first node, or on the controls at both ends."""
        state, first, last = jnp.split(w, [self.problem.state_size, self.problem.variables])
        width = 1.0 / (self.problem.nodes - 1)
        values = [
            c.function(first, last, width, p)
            if isinstance(c.where, AcrossIntervals)
            else value_at(self.problem, c, state, first, p)
            for c, p in zip(_others(self.problem), parameters, strict=True)
        ]
        return jnp.concatenate([jnp.zeros(0, w.dtype), *values])


def _throughout(constraint: Constraint) -> bool:
    return isinstance(constraint.where, Throughout)


def _others(problem: OptimalControlProblem) -> list[Constraint]:
    return [c for c in problem.constraints if not _throughout(c)]


def _sorted(problem: OptimalControlProblem, of_constraints):
    """What belongs to each constraint, of those that hold throughout and of the others."""
    pairs = list(zip(problem.constraints, of_constraints, strict=True))
    return tuple(v for c, v in pairs if _throughout(c)), tuple(v for c, v in pairs if not _throughout(c))


def _rows(problem: OptimalControlProblem) -> list[int]:
    """How many values each constraint has at a point."""

    def value(c, v):
        first = jax.tree.map(lambda p: p[0], c.parameters)
        state, control = jnp.split(v, [problem.state_size])
        if isinstance(c.where, AcrossIntervals):
            return c.function(control, control, 1.0, first)
        return value_at(problem, c, state, control, first)

    like = jax.ShapeDtypeStruct((problem.variables,), float)
    return [jax.eval_shape(functools.partial(value, c), like).shape[0] for c in problem.constraints]


def active_points(constraint: Constraint, points: int) -> Bool[Array, "intervals points"]:
    """Where a constraint holds: in the intervals of its active nodes, and at the last node only if active there.

    A landing cone, say, is left out at its apex, where the goal itself holds the vehicle.
    """
    active = jnp.broadcast_to(constraint.active[:-1, None], (constraint.active.shape[0] - 1, points))
    last_point = active[-1, -1] & (constraint.active[-1] | (points == 1))
    return active.at[-1, -1].set(last_point)


def value_at(problem: OptimalControlProblem, constraint: Constraint, state, control, parameters):
    """A constraint's values at a whole state and a control with the dilation last."""
    physical, time = problem.split_state(state)
    return constraint.function(physical, control[:-1], time, parameters)


def _bend(values: Float[Array, "points rows"]) -> Float[Array, "points rows"]:
    """Second differences, a tenth more; carried on to the ends in a straight line."""
    bend = jnp.diff(values, n=2, axis=0)
    ends = 2.0 * bend[:1] - bend[1:2], 2.0 * bend[-1:] - bend[-2:-1]
    return RESERVE * jnp.concatenate([ends[0], bend, ends[1]])


def _less_margin(values: Float[Array, "points 1"], keep: Float[Array, "points"]) -> Float[Array, "points 1"]:
    """Less what a value may lack between points."""
    bend = _bend(values)
    return values - keep[:, None] * (bend + jnp.sqrt(bend * bend + _KINK**2) - _KINK) / 16.0


def _second_order_less_margin(
    values: Float[Array, "points rows"], keep: Float[Array, "points"]
) -> Float[Array, "points rows"]:
    """Less what a second-order cone's values may lack, all of it taken from the first component."""
    bend = _bend(values)
    size = jnp.sqrt(jnp.sum(bend * bend, axis=1) + _KINK**2) - _KINK  # nothing at the apex
    lack = jnp.sqrt(2.0) / 8.0 * keep * size
    return jnp.concatenate([values[:, :1] - lack[:, None], values[:, 1:]], axis=1)
