"""The Newton system of the optimality conditions at a point, with the inequalities eliminated.

J is the Jacobian of the inequalities, and W the Nesterov-Todd scaling of their slacks and multipliers. The elimination
adds J' W^-2 J to the second derivatives of the Lagrangian. An LQ problem remains.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import Scaling
from jaxscp.core.types import Scalar
from jaxscp.linalg import riccati
from jaxscp.linalg.gram.dispatch import gram
from jaxscp.linalg.gram.system import WeightedRows
from jaxscp.nlp.central_path import RELAXATION
from jaxscp.problem.end_conditions import end_condition, start_condition
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import (
    Jacobians,
    Values,
    at_nodes,
    cones,
    inequalities,
    jacobians,
    last_node_hessian,
)
from jaxscp.transcription.layout import interval_variables, stage_sizes, sum_onto_nodes
from jaxscp.transcription.shooting import Grid, linearise_with_hessian
from jaxscp.transcription.stationarity import equalities_gradient

Scalings = tuple[Scaling, ...]


class SecondOrderModel(eqx.Module):
    """The problem to second order about a point."""

    flow: Float[Array, "intervals states inputs"]
    """Jacobian of every interval's end."""
    initial: Float[Array, "initial states"]
    """Jacobian of the conditions at the start."""
    final: Float[Array, "final states"]
    """Jacobian of the conditions at the end."""
    intervals: Float[Array, "intervals inputs inputs"]
    """Second derivatives of the Lagrangian, by intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """Second derivatives of the terms that belong to nodes."""
    values: Values
    jacobians: Jacobians
    residual: riccati.KKTVector
    """Gradient of the Lagrangian without inequalities, and residuals of the equalities."""


def second_order_model(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> SecondOrderModel:
    """The problem to second order about the point z with multipliers y."""
    (linear, intervals), n = linearise_with_hessian(problem, z, y, grid), problem.state_size
    gradient = equalities_gradient(problem, z, linear, y)
    defect = linear.outputs.end - z[1:, :n]
    return SecondOrderModel(
        flow=linear.jacobian.end,
        initial=linear.initial.jacobian,
        final=linear.final.jacobian,
        intervals=intervals,
        nodes=_end_hessians(problem, z, y).at[-1].add(last_node_hessian(problem, z, y.values)),
        values=inequalities(problem, z, linear.outputs, RELAXATION),
        jacobians=jacobians(problem, z, linear),
        residual=riccati.KKTVector(gradient, defect, linear.initial.value, linear.final.value),
    )


class EliminatedInequalities(eqx.Module):
    """Terms that the eliminated inequalities add to the Newton system."""

    intervals: Float[Array, "intervals inputs inputs"]
    """J' W^-2 J, by intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """J' W^-2 J, by nodes."""
    products: tuple[Float[Array, "nodes variables"], ...]
    """J' v for each of the given vectors v, by node variables."""


def eliminate_inequalities(
    problem: ScaledTimeProblem, jacobians: Jacobians, scalings: Scalings, *vectors: Values
) -> EliminatedInequalities:
    """J' W^-2 J, and J' v for each of the vectors."""
    parts: dict[bool, list[WeightedRows]] = {False: [], True: []}
    for w, jacobian, nodal, *of in zip(scalings, jacobians, at_nodes(problem), *vectors, strict=True):
        none = jnp.zeros((*jacobian.shape[:3], 0), jacobian.dtype)
        stacked = jnp.concatenate([none, *(v[..., None] for v in of)], axis=-1)
        diagonal, vector = w.inverse_square_parts()
        parts[nodal].append(WeightedRows(jacobian, diagonal, vector, stacked))
    nodes = gram(tuple(parts[True]))
    if not parts[False]:
        count, inputs = problem.nodes - 1, interval_variables(problem, nodes.matrix[:, 0]).shape[1]
        blank = jnp.zeros((count, inputs, inputs), nodes.matrix.dtype)
        return EliminatedInequalities(blank, nodes.matrix, tuple(jnp.moveaxis(nodes.products, 1, 0)))
    intervals = gram(tuple(parts[False]))
    pairs = zip(jnp.moveaxis(intervals.products, 1, 0), jnp.moveaxis(nodes.products, 1, 0), strict=True)
    products = tuple(sum_onto_nodes(problem, i) + n for i, n in pairs)
    return EliminatedInequalities(intervals.matrix, nodes.matrix, products)


def newton_matrix(
    problem: ScaledTimeProblem,
    model: SecondOrderModel,
    eliminated: EliminatedInequalities,
    scale: Float[Array, "variables"],
) -> riccati.LQProblem:
    """Matrix of the Newton system in scaled variables, with the inequalities eliminated."""
    both = model.intervals + eliminated.intervals, model.nodes + eliminated.nodes
    return lagrangian_matrix(problem, eqx.tree_at(lambda m: (m.intervals, m.nodes), model, both), scale)


def lagrangian_matrix(
    problem: ScaledTimeProblem, model: SecondOrderModel, scale: Float[Array, "variables"]
) -> riccati.LQProblem:
    """Second derivatives of the Lagrangian in the scaled node variables and the multipliers of the equalities."""
    n, stage = problem.state_size, problem.variables
    intervals = model.intervals.at[:, :stage, :stage].add(model.nodes[:-1])
    sizes = stage_sizes(problem, scale)
    return riccati.LQProblem(
        hessian=intervals * sizes * sizes[:, None],
        last=model.nodes[-1] * scale * scale[:, None],
        flow=model.flow * sizes / scale[:n, None],
        initial=model.initial * scale[:n],
        final=model.final * scale[:n],
    )


def scalings(problem: ScaledTimeProblem, slack: Values, multipliers: Values) -> Scalings:
    """Nesterov-Todd scaling of every pair of a slack and a multiplier."""
    return tuple(cone.scaling(s, y) for cone, s, y in zip(cones(problem), slack, multipliers, strict=True))


def scaled(side: riccati.KKTVector, scale: Float[Array, "variables"]) -> riccati.KKTVector:
    """A right-hand side in scaled variables from one in the variables' own units; the inverse for a solution."""
    return riccati.KKTVector(
        side.nodes * scale, side.flow / scale[: side.flow.shape[1]], side.initial, side.final
    )


def jacobian_product(
    problem: ScaledTimeProblem, jacobians: Jacobians, dz: Float[Array, "nodes variables"]
) -> Values:
    """J dz: derivatives of the inequalities in a direction."""
    dw = interval_variables(problem, dz)
    return tuple(
        jnp.einsum("iprw,iw->ipr", jacobian, dz if nodal else dw)
        for jacobian, nodal in zip(jacobians, at_nodes(problem), strict=True)
    )


def _end_hessians(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], y: Multipliers):
    """Second derivatives of multipliers times end conditions, and of the terminal cost in the last state."""
    n, last = problem.state_size, problem.nodes - 1

    def at_start(state) -> Scalar:
        return jnp.vdot(y.initial, start_condition(problem, state))

    def at_end(state) -> Scalar:
        cost = problem.terminal_cost(z.at[last, :n].set(state))
        return cost + jnp.vdot(y.final, end_condition(problem, state))

    nodes = jnp.zeros((*z.shape, z.shape[1]), z.dtype)
    nodes = nodes.at[0, :n, :n].set(jax.hessian(at_start)(z[0, :n]))
    return nodes.at[last, :n, :n].add(jax.hessian(at_end)(z[last, :n]))
