"""The Newton system of the nonlinear interior point, inequalities eliminated."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones import second_order
from jaxscp.cones.cone import SecondOrder
from jaxscp.linalg import riccati
from jaxscp.linalg.gram.dispatch import gram
from jaxscp.linalg.gram.system import WeightedRows
from jaxscp.nlp.central_path import ROOM
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem, end_condition, start_condition, terminal_cost
from jaxscp.transcription.inequalities import (
    Jacobians,
    Values,
    at_nodes,
    cones,
    inequalities,
    jacobians,
    node_hessians,
)
from jaxscp.transcription.layout import interval_inputs, onto_nodes, stage_sizes
from jaxscp.transcription.shooting import Grid, linearise_with_hessian
from jaxscp.transcription.stationarity import equalities_gradient

Scalings = tuple["OrthantScaling | second_order.SecondOrderScaling", ...]


class SecondOrderModel(eqx.Module):
    """The problem about an iterate, to second order."""

    flow: Float[Array, "intervals states inputs"]
    """Jacobian of every interval's end."""
    initial: Float[Array, "initial states"]
    """Jacobian of the conditions at the start."""
    final: Float[Array, "final states"]
    """Jacobian of the conditions at the end."""
    intervals: Float[Array, "intervals inputs inputs"]
    """Second derivatives of the Lagrangian, by intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """And what belongs to nodes alone."""
    values: Values
    jacobians: Jacobians
    lack: riccati.KKTVector
    """Gradient of the Lagrangian without inequalities, and residuals of the equalities."""


def local(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: Multipliers, grid: Grid
) -> SecondOrderModel:
    """Everything about a point, to second order."""
    (linear, intervals), n = linearise_with_hessian(problem, z, y, grid), problem.state_size
    gradient = equalities_gradient(problem, z, linear, y)
    defect = linear.outputs.end - z[1:, :n]
    return SecondOrderModel(
        flow=linear.jacobian.end,
        initial=linear.initial.jacobian,
        final=linear.final.jacobian,
        intervals=intervals,
        nodes=node_hessians(problem, z, y.values) + _ends_hessians(problem, z, y),
        values=inequalities(problem, z, linear.outputs, ROOM),
        jacobians=jacobians(problem, z, linear),
        lack=riccati.KKTVector(gradient, defect, linear.initial.value, linear.final.value),
    )


class Weighed(eqx.Module):
    """What the inequalities, eliminated, add to the Newton system."""

    intervals: Float[Array, "intervals inputs inputs"]
    """J' W^-2 J, of those of intervals."""
    nodes: Float[Array, "nodes variables variables"]
    """And of those of nodes."""
    sides: tuple[Float[Array, "nodes variables"], ...]
    """J' v of all, by nodes."""


def weighed(problem: OptimalControlProblem, jacobians: Jacobians, weigh: Scalings, *sides: Values) -> Weighed:
    """Eliminate the inequalities; with J' v for so many v."""
    parts: dict[bool, list[WeightedRows]] = {False: [], True: []}
    for w, jacobian, nodal, *of in zip(weigh, jacobians, at_nodes(problem), *sides, strict=True):
        none = jnp.zeros((*jacobian.shape[:3], 0), jacobian.dtype)
        stacked = jnp.concatenate([none, *(v[..., None] for v in of)], axis=-1)
        parts[nodal].append(WeightedRows(jacobian, *_weights(w), stacked))
    nodes = gram(tuple(parts[True]))
    if not parts[False]:
        count, inputs = problem.nodes - 1, interval_inputs(problem, nodes.matrix[:, 0]).shape[1]
        blank = jnp.zeros((count, inputs, inputs), nodes.matrix.dtype)
        return Weighed(blank, nodes.matrix, tuple(jnp.moveaxis(nodes.products, 1, 0)))
    intervals = gram(tuple(parts[False]))
    pulls = zip(jnp.moveaxis(intervals.products, 1, 0), jnp.moveaxis(nodes.products, 1, 0), strict=True)
    return Weighed(intervals.matrix, nodes.matrix, tuple(onto_nodes(problem, i) + n for i, n in pulls))


def _weights(w: "OrthantScaling | second_order.SecondOrderScaling"):
    """W^-2 as a diagonal and, of a second-order cone, a vector whose square is added."""
    if isinstance(w, OrthantScaling):
        return w.inverse_square(jnp.ones_like(w.slack)), None
    size = w.eta[..., None]
    return -second_order.reflect(jnp.ones_like(w.w)) / size**2, jnp.sqrt(2.0) * second_order.reflect(
        w.w
    ) / size


def newton_chain(
    problem: OptimalControlProblem,
    here: SecondOrderModel,
    condensed: Weighed,
    scale: Float[Array, "variables"],
) -> riccati.LQProblem:
    """Matrix of the Newton system in scaled variables, inequalities eliminated: the Lagrangian's second derivatives,
    and W^-2 of every cone."""
    both = here.intervals + condensed.intervals, here.nodes + condensed.nodes
    return lagrangian_chain(problem, eqx.tree_at(lambda h: (h.intervals, h.nodes), here, both), scale)


def lagrangian_chain(
    problem: OptimalControlProblem, here: SecondOrderModel, scale: Float[Array, "variables"]
) -> riccati.LQProblem:
    """The Lagrangian's second derivatives in the scaled node variables and the multipliers of the equalities."""
    n, stage = problem.state_size, problem.variables
    intervals = here.intervals.at[:, :stage, :stage].add(here.nodes[:-1])
    sizes = stage_sizes(problem, scale)
    return riccati.LQProblem(
        hessian=intervals * sizes * sizes[:, None],
        last=here.nodes[-1] * scale * scale[:, None],
        flow=here.flow * sizes / scale[:n, None],
        initial=here.initial * scale[:n],
        final=here.final * scale[:n],
    )


class OrthantScaling(eqx.Module):
    """Nesterov-Todd scaling W of values that are nonnegative: W^2 = s / y."""

    slack: Float[Array, "*b"]
    price: Float[Array, "*b"]

    def square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^2 v."""
        return v * self.slack / self.price

    def inverse_square(self, v: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """W^-2 v."""
        return v * self.price / self.slack


def scalings(problem: OptimalControlProblem, slack: Values, prices: Values) -> Scalings:
    """The Nesterov-Todd scaling of every pair of a slack and its price."""

    def one(cone, s, y):
        return (
            second_order.second_order_scaling(s, y) if isinstance(cone, SecondOrder) else OrthantScaling(s, y)
        )

    return tuple(map(one, cones(problem), slack, prices))


def scaled(side: riccati.KKTVector, scale: Float[Array, "variables"]) -> riccati.KKTVector:
    """Right-hand side of the system in scaled variables, from one in the variables' own units; and the unknowns in
    their own units, from scaled ones."""
    return riccati.KKTVector(
        side.nodes * scale, side.flow / scale[: side.flow.shape[1]], side.initial, side.final
    )


def _ends_hessians(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: Multipliers):
    """Second derivatives of the conditions at both ends, times their multipliers, and of the terminal cost in the
    last state."""
    n, last = problem.state_size, problem.nodes - 1

    def at_start(state):
        return jnp.vdot(y.initial, start_condition(problem, state))

    def at_end(state):
        cost = terminal_cost(problem, z.at[last, :n].set(state))
        return cost + jnp.vdot(y.final, end_condition(problem, state))

    nodes = jnp.zeros((*z.shape, z.shape[1]), z.dtype)
    nodes = nodes.at[0, :n, :n].set(jax.hessian(at_start)(z[0, :n]))
    return nodes.at[last, :n, :n].add(jax.hessian(at_end)(z[last, :n]))


def along(
    problem: OptimalControlProblem, jacobians: Jacobians, dz: Float[Array, "nodes variables"]
) -> Values:
    """Slopes of the inequalities along a direction."""
    dw = interval_inputs(problem, dz)
    return tuple(
        jnp.einsum("iprw,iw->ipr", jacobian, dz if nodal else dw)
        for jacobian, nodal in zip(jacobians, at_nodes(problem), strict=True)
    )
