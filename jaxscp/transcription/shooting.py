"""Multiple shooting: the end state, running cost and constraint values of an interval, as functions of its variables.

An interval's variables are w = (x_i, U_i, U_{i+1}): the state at its first node, and the controls with their dilation
at both. Path constraints hold at equally spaced points of every interval, its ends included. A margin covers the path
between those points: where a value's second difference over three points is d, the value dips below the chord by at
most d / 8 (to fourth order). The margin is a tenth more.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.cones.cone import Cone
from jaxscp.core.types import Scalar
from jaxscp.integration import dispatch, tableaus
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals, OutputGroup, PathOutputs
from jaxscp.problem.end_conditions import Condition, linearised_ends
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.transcription.interval_inputs import (
    QuadraticCost,
    hessian_in_variables,
    in_variables,
    integration_inputs,
)
from jaxscp.transcription.layout import interval_variables

METHOD = tableaus.SIXTH_ORDER
RESERVE = 1.1  # factor of the margin: a path may curve more between the points than at them


class Grid(eqx.Module):
    """Points of an interval, for integration and constraints.

    Args:
        subintervals: between the points at which constraints hold, three at least.
        steps: sixth-order Runge-Kutta steps of a subinterval.
    """

    subintervals: int = eqx.field(default=5, static=True)
    steps: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.subintervals < 3 or self.steps < 1:
            raise ValueError(
                f"a grid needs 3 subintervals and 1 step or more, not {self.subintervals} and {self.steps}"
            )

    @property
    def all_steps(self) -> int:
        """Runge-Kutta steps of an interval."""
        return self.subintervals * self.steps


class Outputs(eqx.Module):
    """Outputs of one interval, or of many along the leading axis; in Jacobians inputs are the last axis."""

    end: Float[Array, "..."]
    """(states,): state at the end."""
    cost: Float[Array, "..."]
    """(): running cost."""
    values: tuple[Float[Array, "..."], ...]
    """(points, rows) of every constraint, less the margin; one point if it does not hold throughout."""


class Linearisation(eqx.Module):
    """Intervals and end conditions to first order about a point."""

    outputs: Outputs
    jacobian: Outputs
    """With respect to w, which is the last axis."""
    initial: Condition
    """At the start."""
    final: Condition
    """At the end."""


@eqx.filter_jit  # traced once for all calls of one program
def evaluate(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """Outputs of every interval."""
    data = interval_data(problem, grid)
    found = dispatch.evaluate(intervals_of(problem, grid), integration_inputs(problem, z), data)
    return with_quadratic_cost(problem, z, by_constraint(problem, found))


@eqx.filter_jit
def linearise(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Linearisation:
    """Outputs of every interval and their Jacobians."""
    data = interval_data(problem, grid)
    found = dispatch.linearise(intervals_of(problem, grid), integration_inputs(problem, z), data)
    return _linearisation(problem, z, *found)


@eqx.filter_jit
def linearise_with_hessian(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> tuple[Linearisation, Float[Array, "intervals inputs inputs"]]:
    """Every interval linearised, and the second derivatives of the Lagrangian, one block an interval.

    The Lagrangian couples intervals only linearly. A constraint at nodes counts at the first node of every interval.
    End conditions, terminal cost and constraints at the last node are left out: they belong to nodes.
    """
    values = tuple(  # on the central path, an inactive constraint has a multiplier too
        jnp.where(c.active_in_intervals(v.shape[1])[:, :, None], -v, 0.0)
        for c, v in zip(problem.constraints, y.by_interval(), strict=True)
    )
    weights = interval_weights(problem, Outputs(y.flow, jnp.ones(problem.nodes - 1, z.dtype), values))
    intervals, w = intervals_of(problem, grid), integration_inputs(problem, z)
    found, jacobian, hessian = dispatch.linearise_with_hessian(
        intervals, w, interval_data(problem, grid), weights
    )
    hessian = hessian_in_variables(problem, hessian)
    if (quadratic := QuadraticCost.of(problem)) is not None:
        hessian += quadratic.hessian
    return _linearisation(problem, z, found, jacobian), hessian


def served_by(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Int[Array, ""]:
    """Index into ``BACKENDS`` of the implementation that finds second derivatives."""
    data = interval_data(problem, grid)
    return dispatch.served_by(intervals_of(problem, grid), integration_inputs(problem, z), data, order=2)


def _linearisation(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    found: IntervalOutputs,
    jacobian: IntervalOutputs,
) -> Linearisation:
    jacobian = jax.tree.map(lambda v: in_variables(problem, v), jacobian)
    outputs = with_quadratic_cost(problem, z, by_constraint(problem, found))
    slopes = by_constraint(problem, jacobian)
    if (quadratic := QuadraticCost.of(problem)) is not None:
        gradient = quadratic.gradient(interval_variables(problem, z))
        slopes = eqx.tree_at(lambda o: o.cost, slopes, slopes.cost + gradient)
    return Linearisation(outputs, slopes, *linearised_ends(problem, z))


def total_cost(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], outputs: Outputs) -> Scalar:
    """Running and terminal cost of a point with these outputs, without the ``QuadraticCost``."""
    total, quadratic = jnp.sum(outputs.cost) + problem.terminal_cost(z), QuadraticCost.of(problem)
    return total if quadratic is None else total - jnp.sum(quadratic.value(interval_variables(problem, z)))


def with_quadratic_cost(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], outputs: Outputs
) -> Outputs:
    """Outputs with the ``QuadraticCost`` of every interval, if the problem needs one."""
    quadratic = QuadraticCost.of(problem)
    if quadratic is None:
        return outputs
    cost = quadratic.value(interval_variables(problem, z))
    return eqx.tree_at(lambda o: o.cost, outputs, outputs.cost + cost)


def intervals_of(problem: ScaledTimeProblem, grid: Grid) -> Intervals:
    """The integration of a problem's intervals."""
    functions = _ConstraintValues(problem)
    groups = tuple(
        OutputGroup(rows, c.cone.condition_rows(rows), _Margin(c.cone))
        for c, rows in zip(problem.constraints, _rows(problem), strict=True)
        if c.where.throughout
    )
    outputs = PathOutputs(functions.at_point, functions.at_ends, groups)
    return Intervals(problem.slope, problem.state_size, METHOD, grid.all_steps, grid.steps, outputs)


def interval_data(problem: ScaledTimeProblem, grid: Grid) -> IntervalData:
    """Data of every interval: the parameters of each constraint at its first node, and the mask of the margin.

    The two ends of the trajectory have no margin: end conditions hold there, and a goal may lie on the floor.
    """
    parameters = [jax.tree.map(lambda p: p[:-1], c.node_parameters()) for c in problem.constraints]
    mask = jnp.ones((problem.nodes - 1, grid.subintervals + 1)).at[0, 0].set(0.0).at[-1, -1].set(0.0)
    return IntervalData(*_partition(problem, parameters), mask)


def by_constraint(problem: ScaledTimeProblem, found: IntervalOutputs) -> Outputs:
    """Outputs of an integration (or their Jacobian), sorted by constraint."""
    rows = [n for c, n in zip(problem.constraints, _rows(problem), strict=True) if not c.where.throughout]
    points, before, values = iter(found.points), 0, []
    for constraint in problem.constraints:
        if constraint.where.throughout:
            values.append(next(points))
        else:
            count = rows.pop(0)
            values.append(found.ends[:, None, before : before + count])
            before += count
    return Outputs(found.end, found.cost, tuple(values))


def interval_weights(problem: ScaledTimeProblem, weights: Outputs) -> IntervalOutputs:
    """The adjoint of ``by_constraint``: weights of an integration's outputs, from weights of ``Outputs``."""
    points, ends = _partition(problem, weights.values)
    flat = [v[:, 0] for v in ends]
    none = jnp.zeros((weights.end.shape[0], 0), weights.end.dtype)
    return IntervalOutputs(weights.end, weights.cost, points, jnp.concatenate([none, *flat], axis=1))


def end_value(problem: ScaledTimeProblem, c: PathConstraint, state, first, last, parameters) -> Array:
    """Values of an interval: at its first node, or on the controls at both ends."""
    if c.where.across:
        return problem.value_across(c, first, last, parameters)
    return problem.value_at(c, state, first, parameters)


class _ConstraintValues(eqx.Module):
    """Values of all constraints, concatenated."""

    problem: ScaledTimeProblem

    def at_point(self, state, control, parameters) -> Float[Array, "rows"]:
        """Values of the constraints that hold throughout."""
        active = [c for c in self.problem.constraints if c.where.throughout]
        control = control[: self.problem.variables - self.problem.state_size]  # without the cost's parameters
        values = [
            self.problem.value_at(c, state, control, p) for c, p in zip(active, parameters, strict=True)
        ]
        return jnp.concatenate([jnp.zeros(0, state.dtype), *values])

    def at_ends(self, w, parameters) -> Float[Array, "rows"]:
        """Values of the others: at the first node, or on the controls at both ends."""
        n, own = self.problem.state_size, self.problem.variables - self.problem.state_size
        state, first, last = jnp.split(w, [n, (n + w.shape[0]) // 2])
        others = [c for c in self.problem.constraints if not c.where.throughout]
        values = [
            end_value(self.problem, c, state, first[:own], last[:own], p)
            for c, p in zip(others, parameters, strict=True)
        ]
        return jnp.concatenate([jnp.zeros(0, w.dtype), *values])


class _Margin(eqx.Module):
    """Values of one condition at the points of an interval, less the margin for the path between them."""

    cone: Cone

    def __call__(
        self, values: Float[Array, "points rows"], mask: Float[Array, "points"]
    ) -> Float[Array, "points rows"]:
        second_difference = jnp.diff(values, n=2, axis=0)
        first = 2.0 * second_difference[:1] - second_difference[1:2]  # extrapolated to the ends
        last = 2.0 * second_difference[-1:] - second_difference[-2:-1]
        second_difference = RESERVE * jnp.concatenate([first, second_difference, last])
        return self.cone.tighten(values, second_difference, mask)


def _partition(problem: ScaledTimeProblem, by_constraint):
    """Items of the constraints that hold throughout, and of the others."""
    pairs = list(zip(problem.constraints, by_constraint, strict=True))
    return (
        tuple(v for c, v in pairs if c.where.throughout),
        tuple(v for c, v in pairs if not c.where.throughout),
    )


def _rows(problem: ScaledTimeProblem) -> list[int]:
    """Number of values of each constraint at a point."""

    def value(c: PathConstraint, v):
        first = jax.tree.map(lambda p: p[0], c.node_parameters())
        state, control = jnp.split(v, [problem.state_size])
        return end_value(problem, c, state, control, control, first)

    like = jax.ShapeDtypeStruct((problem.variables,), float)
    return [jax.eval_shape(functools.partial(value, c), like).shape[0] for c in problem.constraints]
