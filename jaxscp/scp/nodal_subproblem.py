"""From a problem and a reference to the convex subproblem (equation 19)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative, SecondOrder, Zero
from jaxscp.conic.program import Cones, CouplingRows, HalfSpaceRows, NormCost, StagedProgram
from jaxscp.core.types import Scalar
from jaxscp.problem.constraint import AcrossIntervals, Constraint
from jaxscp.problem.problem import Boundary, OptimalControlProblem, terminal_cost
from jaxscp.transcription.discretise import Discretisation

PAPER_NODES = 30
"""Of the paper's flights, for which weights are given."""


class NormTrustRegion(eqx.Module):
    """The paper's trust region (19f): cost ``weight |z_k - zref_k|``, not squared, at each of 30 nodes.

    An exact penalty on moving: iterations stop wherever the merit's slope is below the weight, optimal or not. With
    other numbers of nodes the weight is theirs in proportion, so that the sum prices the move of a flight as a whole,
    whatever its nodes: else moving would cost more than virtual control on fine grids, which would stay.
    """

    weight: float = 10.0

    def at_node(self, nodes: int) -> float:
        """Weight of each of so many nodes."""
        return self.weight * PAPER_NODES / nodes


class ProximalTrustRegion(eqx.Module):
    """Cost ``weight |z_k - zref_k|^2`` at each of 30 nodes, and with others in proportion: vanishes to second order, so
    that fixed points are optimal."""

    weight: float = 0.1

    def at_node(self, nodes: int) -> float:
        """Weight of each of so many nodes."""
        return self.weight * PAPER_NODES / nodes


TrustRegion = NormTrustRegion | ProximalTrustRegion


class LinearCost(eqx.Module):
    """The problem's cost, linearised: ``gradient . z + constant``."""

    gradient: Float[Array, "nodes variables"]
    constant: Scalar

    def __call__(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Predicted cost of node variables."""
        return jnp.vdot(self.gradient, z) + self.constant


def convexify(
    problem: OptimalControlProblem,
    reference: Float[Array, "nodes variables"],
    flow: Discretisation,
    trust_region: TrustRegion,
    virtual_weight: float,
) -> tuple[StagedProgram, LinearCost]:
    """Linearise the problem about a reference.

    Args:
        problem: what is asked.
        reference: (nodes, variables).
        flow: the problem's flow, linearised about the reference.
        trust_region: how moving away from the reference is priced.
        virtual_weight: price of virtual control, w_vc.

    Returns:
        The subproblem, and the cost without its penalties.
    """
    for constraint in problem.constraints:
        if isinstance(constraint.where, AcrossIntervals):
            raise ValueError(
                f"{constraint.name}: this method has no constraints across intervals; use NewtonSCP."
            )
    cost = linear_cost(problem, reference, flow)
    linear = [_linear_constraint(problem, c, reference) for c in problem.constraints]
    kinds = [(c.cone, matrix, value) for c, (matrix, value) in zip(problem.constraints, linear, strict=True)]
    equalities = [(matrix, value) for cone, matrix, value in kinds if isinstance(cone, Zero)]
    rows = [(matrix, value) for cone, matrix, value in kinds if isinstance(cone, NonNegative)]
    cones = [(matrix, value) for cone, matrix, value in kinds if isinstance(cone, SecondOrder)]
    rows.append(_dilation_limits(problem, reference))
    program = StagedProgram(
        hessian=jnp.zeros((*reference.shape, reference.shape[1]), reference.dtype),
        gradient=cost.gradient,
        links=_links(problem, reference, flow, equalities, virtual_weight),
        # values >= 0 at z:  value + matrix (z - zref) >= 0  is  (-matrix) z <= value - matrix zref
        rows=HalfSpaceRows(
            *(jnp.concatenate(part, axis=1) for part in zip(*map(_negate_matrix, rows), strict=True))
        ),
        cones=tuple(Cones(*(part[:, None] for part in _negate_matrix(cone))) for cone in cones),
    )
    return _with_trust_region(program, reference, trust_region), cost


def linear_cost(
    problem: OptimalControlProblem, reference: Float[Array, "nodes variables"], flow: Discretisation
) -> LinearCost:
    """Running and terminal cost, linearised about the reference."""
    n = problem.variables
    terminal, gradient = jax.value_and_grad(lambda z: terminal_cost(problem, z))(reference)
    if problem.carries_cost:
        return LinearCost(
            gradient.at[-1, problem.dynamics.state_size].add(1.0), terminal - jnp.vdot(gradient, reference)
        )
    gradient = gradient.at[:-1].add(flow.cost_jacobian[:, :n])
    gradient = gradient.at[1:, problem.state_size :].add(flow.cost_jacobian[:, n:])
    return LinearCost(gradient, jnp.sum(flow.cost) + terminal - jnp.vdot(gradient, reference))


def _linear_constraint(
    problem: OptimalControlProblem, constraint: Constraint, reference: Float[Array, "nodes variables"]
) -> tuple[Array, Array]:
    """(matrix, value - matrix zref) of a constraint at every node; trivially satisfied where inactive."""

    def value(z, parameters):
        state, time, control, _ = problem.split(z)
        return constraint.function(state, control, time, parameters)

    def at_node(z: Array, parameters, active: Array):
        matrix: Array = jax.jacfwd(value)(z, parameters)
        v: Array = value(z, parameters)
        inactive = jnp.zeros_like(v)
        if not isinstance(constraint.cone, Zero):
            inactive = inactive.at[0 if isinstance(constraint.cone, SecondOrder) else slice(None)].set(1.0)
        offset: Array = jnp.where(active, v - matrix @ z, inactive)
        return jnp.where(active, matrix, 0.0), offset

    return jax.vmap(at_node)(reference, constraint.parameters, constraint.active)


def _dilation_limits(
    problem: OptimalControlProblem, reference: Float[Array, "nodes variables"]
) -> tuple[Array, Array]:
    last = jnp.zeros(problem.variables, reference.dtype).at[-1].set(1.0)
    matrix = jnp.broadcast_to(jnp.stack([last, -last]), (problem.nodes, 2, problem.variables))
    offset = jnp.stack([-problem.dilation_min, problem.dilation_max])
    return matrix, jnp.broadcast_to(offset, (problem.nodes, 2))


def _negate_matrix(pair: tuple[Array, Array]) -> tuple[Array, Array]:
    matrix, offset = pair
    return -matrix, offset


def _linear_boundary(problem: OptimalControlProblem, boundary: Boundary, z: Float[Array, "variables"]):
    """(matrix, right-hand side) of a boundary condition linearised at one node."""

    def value(z):
        state, time, _, _ = problem.split(z)
        return boundary.function(state, time, boundary.parameters)

    matrix = jax.jacfwd(value)(z)
    return matrix, matrix @ z - value(z)


def _links(problem, reference, flow: Discretisation, equalities, virtual_weight) -> CouplingRows:
    n, states, dtype = problem.variables, problem.state_size, reference.dtype
    initial, initial_right = _linear_boundary(problem, problem.initial, reference[0])
    final, final_right = _linear_boundary(problem, problem.final, reference[-1])
    carried = jnp.eye(n, dtype=dtype)[
        problem.dynamics.state_size : states
    ]  # running cost and time start at zero
    initial = jnp.concatenate([initial, carried])
    initial_right = jnp.concatenate([initial_right, jnp.zeros(carried.shape[0], dtype)])
    m = max(states, initial.shape[0], final.shape[0])
    pad = lambda a, axis: jnp.pad(  # noqa: E731
        a, [(0, m - a.shape[axis]) if i == axis else (0, 0) for i in range(a.ndim)]
    )

    # dynamics:  A x_i + B- u_i + (B+ u_{i+1} - x_{i+1}) + nu = A xref + B- uref + B+ uref+ - F
    jacobian = flow.state_jacobian
    w = jnp.concatenate([reference[:-1], reference[1:, states:]], axis=1)
    before = jacobian[:, :, :n]
    identity = jnp.broadcast_to(-jnp.eye(states, dtype=dtype), (problem.nodes - 1, states, states))
    after = jnp.concatenate([identity, jacobian[:, :, n:]], axis=2)
    right = jnp.einsum("irw,iw->ir", jacobian, w) - flow.state

    zero_matrix, zero_right = jnp.zeros((1, m, n), dtype), jnp.zeros((1, m), dtype)
    soft = jnp.zeros((m,), dtype).at[: problem.dynamics.state_size].set(1.0)
    soft = jnp.concatenate([zero_right, jnp.broadcast_to(soft, (problem.nodes - 1, m)), zero_right])
    before = jnp.concatenate([zero_matrix, pad(before, 1), pad(final, 0)[None]])
    after = jnp.concatenate([pad(initial, 0)[None], pad(after, 1), zero_matrix])
    offset = jnp.concatenate([pad(initial_right, 0)[None], pad(right, 1), pad(final_right, 0)[None]])
    for matrix, value in equalities:  # node k's equalities ride on link k, as hard rows after it
        extra = matrix.shape[1]
        none = jnp.zeros((1, extra, n), dtype)
        before = jnp.concatenate([before, jnp.zeros((problem.nodes + 1, extra, n), dtype)], axis=1)
        after = jnp.concatenate([after, jnp.concatenate([matrix, none])], axis=1)
        offset = jnp.concatenate([offset, jnp.concatenate([-value, none[:, :, 0]])], axis=1)
        soft = jnp.pad(soft, ((0, 0), (0, extra)))
    weight = jnp.full((problem.nodes + 1,), virtual_weight, dtype)
    return CouplingRows(before, after, offset, soft, weight)


def _with_trust_region(
    program: StagedProgram, reference: Float[Array, "nodes variables"], trust_region: TrustRegion
) -> StagedProgram:
    weight = trust_region.at_node(program.nodes)
    if isinstance(trust_region, NormTrustRegion):
        every = jnp.full((program.nodes,), weight, reference.dtype)
        norm = NormCost(every, jnp.ones_like(reference), reference)
        return eqx.tree_at(lambda p: p.norm, program, norm, is_leaf=lambda v: v is None)
    curvature = 2.0 * weight
    hessian = program.hessian + curvature * jnp.eye(program.variables, dtype=reference.dtype)
    return eqx.tree_at(
        lambda p: (p.hessian, p.gradient), program, (hessian, program.gradient - curvature * reference)
    )
