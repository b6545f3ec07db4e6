"""The convex subproblem of ``PTR``, over nodes (equation 19)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.kinds import by_cone
from jaxscp.conic.program import Cones, CouplingRows, HalfSpaceRows, NormCost, StagedProgram
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Scalar
from jaxscp.problem.end_conditions import Condition, linearised_ends
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.transcription.discretise import Discretisation

PAPER_NODES = 30
"""Nodes of the paper's plans, for which its weights are given."""


class TrustRegion(eqx.Module):
    """Penalty on the distance from the reference, at each of 30 nodes.

    With another number of nodes the weight of a node is scaled, so that the sum over the trajectory stays the same.
    Otherwise, on fine grids, moving would cost more than virtual control.
    """

    weight: float

    def at_node(self, nodes: int) -> float:
        """Weight of each of that many nodes."""
        return self.weight * PAPER_NODES / nodes

    def add_to(self, program: StagedProgram, reference: Float[Array, "nodes variables"]) -> StagedProgram:
        """The program with the penalty added to its cost."""
        raise NotImplementedError


class NormTrustRegion(TrustRegion):
    """The paper's trust region (19f): cost ``weight |z_k - zref_k|``, not squared.

    An exact penalty on moving: iterations stop wherever the merit's slope is below the weight, optimal or not.
    """

    weight: float = 10.0

    def add_to(self, program: StagedProgram, reference: Float[Array, "nodes variables"]) -> StagedProgram:
        """The program with a norm cost."""
        every = jnp.full((program.nodes,), self.at_node(program.nodes), reference.dtype)
        norm = NormCost(every, jnp.ones_like(reference), reference)
        return eqx.tree_at(lambda p: p.norm, program, norm, is_leaf=lambda v: v is None)


class ProximalTrustRegion(TrustRegion):
    """Cost ``weight |z_k - zref_k|^2``, which vanishes to second order, so that fixed points are optimal."""

    weight: float = 0.1

    def add_to(self, program: StagedProgram, reference: Float[Array, "nodes variables"]) -> StagedProgram:
        """The program with a larger Hessian."""
        curvature = 2.0 * self.at_node(program.nodes)
        hessian = program.hessian + curvature * jnp.eye(program.variables, dtype=reference.dtype)
        return eqx.tree_at(
            lambda p: (p.hessian, p.gradient), program, (hessian, program.gradient - curvature * reference)
        )


class LinearCost(eqx.Module):
    """The problem's cost, linearised: ``gradient . z + constant``."""

    gradient: Float[Array, "nodes variables"]
    constant: Scalar

    def __call__(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Predicted cost of node variables."""
        return jnp.vdot(self.gradient, z) + self.constant


def nodal_subproblem(
    problem: ScaledTimeProblem,
    reference: Float[Array, "nodes variables"],
    flow: Discretisation,
    trust_region: TrustRegion,
    virtual_weight: float,
) -> tuple[StagedProgram, LinearCost]:
    """Linearise the problem about a reference.

    Args:
        problem: to be solved.
        reference: (nodes, variables).
        flow: the problem's flow, linearised about the reference.
        trust_region: penalty on the distance from the reference.
        virtual_weight: penalty weight of virtual control, w_vc.

    Returns:
        The subproblem, and the cost without its penalties.

    Raises:
        InvalidProblem: for a constraint across intervals; the message names it.
    """
    for constraint in problem.constraints:
        if constraint.where.across:
            raise InvalidProblem(
                f"{constraint.name}: this method has no constraints across intervals; use NewtonSCP."
            )
    cost = linear_cost(problem, reference, flow)
    linear = [_linear_constraint(problem, c, reference) for c in problem.constraints]
    kinds = by_cone(c.cone for c in problem.constraints)
    rows = [linear[i] for i in kinds.nonnegative]
    rows.append(_node_limits(problem, reference))
    links = _coupling(problem, reference, flow, virtual_weight)
    for i in kinds.zero:
        links = _with_equalities(links, *linear[i])
    program = StagedProgram(
        hessian=jnp.zeros((*reference.shape, reference.shape[1]), reference.dtype),
        gradient=cost.gradient,
        links=links,
        # values >= 0 at z:  value + matrix (z - zref) >= 0  is  (-matrix) z <= value - matrix zref
        rows=HalfSpaceRows(
            *(jnp.concatenate(part, axis=1) for part in zip(*map(_negate_matrix, rows), strict=True))
        ),
        cones=tuple(
            Cones(*(part[:, None] for part in _negate_matrix(linear[i]))) for i in kinds.second_order
        ),
    )
    return trust_region.add_to(program, reference), cost


def linear_cost(
    problem: ScaledTimeProblem, reference: Float[Array, "nodes variables"], flow: Discretisation
) -> LinearCost:
    """Running and terminal cost, linearised about the reference."""
    n = problem.variables
    terminal, gradient = jax.value_and_grad(problem.terminal_cost)(reference)
    if problem.carries_cost:
        return LinearCost(
            gradient.at[-1, problem.dynamic_states].add(1.0), terminal - jnp.vdot(gradient, reference)
        )
    gradient = gradient.at[:-1].add(flow.cost_jacobian[:, :n])
    gradient = gradient.at[1:, problem.state_size :].add(flow.cost_jacobian[:, n:])
    return LinearCost(gradient, jnp.sum(flow.cost) + terminal - jnp.vdot(gradient, reference))


def _linear_constraint(
    problem: ScaledTimeProblem, constraint: PathConstraint, reference: Float[Array, "nodes variables"]
) -> tuple[Array, Array]:
    """(matrix, value - matrix zref) of a constraint at every node; rows that always hold where inactive."""

    states = problem.state_size

    def value(z, parameters):
        return problem.value_at(constraint, z[:states], z[states:], parameters)

    def at_node(z: Array, parameters, active: Array):
        matrix: Array = jax.jacfwd(value)(z, parameters)
        v: Array = value(z, parameters)
        offset: Array = jnp.where(active, v - matrix @ z, constraint.cone.inactive_value(v))
        return jnp.where(active, matrix, 0.0), offset

    return jax.vmap(at_node)(reference, constraint.node_parameters(), constraint.active)


def _node_limits(
    problem: ScaledTimeProblem, reference: Float[Array, "nodes variables"]
) -> tuple[Array, Array]:
    matrix = problem.node_limits_jacobian(reference.dtype)
    offset = problem.node_limits(jnp.zeros_like(reference))
    return jnp.broadcast_to(matrix, (problem.nodes, *matrix.shape)), offset


def _negate_matrix(pair: tuple[Array, Array]) -> tuple[Array, Array]:
    matrix, offset = pair
    return -matrix, offset


def _linear_end(condition: Condition, z: Float[Array, "variables"]):
    """(matrix, right-hand side) of the conditions at one end, from their linearisation at its node."""
    matrix = _padded(condition.jacobian, 1, z.shape[0])
    return matrix, matrix @ z - condition.value


def _padded(a: Array, axis: int, size: int) -> Array:
    """The array with zeros appended along an axis, up to a size."""
    return jnp.pad(a, [(0, size - a.shape[axis]) if i == axis else (0, 0) for i in range(a.ndim)])


def _coupling(
    problem: ScaledTimeProblem,
    reference: Float[Array, "nodes variables"],
    flow: Discretisation,
    virtual_weight: float,
) -> CouplingRows:
    """Rows between nodes: both ends (hard), and the dynamics (soft).

    The dynamics:

        A x_i + B- u_i + (B+ u_{i+1} - x_{i+1}) + nu = A xref + B- uref + B+ uref+ - F
    """
    n, states, dtype = problem.variables, problem.state_size, reference.dtype
    at_start, at_end = linearised_ends(problem, reference)
    initial, initial_rhs = _linear_end(at_start, reference[0])
    final, final_rhs = _linear_end(at_end, reference[-1])
    m = max(states, initial.shape[0], final.shape[0])

    jacobian = flow.state_jacobian
    w = jnp.concatenate([reference[:-1], reference[1:, states:]], axis=1)
    before = jacobian[:, :, :n]
    identity = jnp.broadcast_to(-jnp.eye(states, dtype=dtype), (problem.nodes - 1, states, states))
    after = jnp.concatenate([identity, jacobian[:, :, n:]], axis=2)
    rhs = jnp.einsum("irw,iw->ir", jacobian, w) - flow.state

    zero_matrix, zero_rhs = jnp.zeros((1, m, n), dtype), jnp.zeros((1, m), dtype)
    soft = jnp.zeros((m,), dtype).at[: problem.dynamic_states].set(1.0)
    soft = jnp.concatenate([zero_rhs, jnp.broadcast_to(soft, (problem.nodes - 1, m)), zero_rhs])
    before = jnp.concatenate([zero_matrix, _padded(before, 1, m), _padded(final, 0, m)[None]])
    after = jnp.concatenate([_padded(initial, 0, m)[None], _padded(after, 1, m), zero_matrix])
    offset = jnp.concatenate(
        [_padded(initial_rhs, 0, m)[None], _padded(rhs, 1, m), _padded(final_rhs, 0, m)[None]]
    )
    weight = jnp.full((problem.nodes + 1,), virtual_weight, dtype)
    return CouplingRows(before, after, offset, soft, weight)


def _with_equalities(
    links: CouplingRows, matrix: Float[Array, "nodes rows n"], value: Float[Array, "nodes rows"]
) -> CouplingRows:
    """The coupling with equalities of node k as hard rows of coupling k, which follows the node before."""
    extra, n = matrix.shape[1:]
    none = jnp.zeros((1, extra, n), matrix.dtype)
    before = jnp.concatenate(
        [links.before, jnp.zeros((links.before.shape[0], extra, n), matrix.dtype)], axis=1
    )
    after = jnp.concatenate([links.after, jnp.concatenate([matrix, none])], axis=1)
    offset = jnp.concatenate([links.offset, jnp.concatenate([-value, none[:, :, 0]])], axis=1)
    return CouplingRows(before, after, offset, jnp.pad(links.soft, ((0, 0), (0, extra))), links.weight)
