"""The convex subproblem of ``NewtonSCP``: a chain of stages w_i = (x_i, U_i, U_{i+1}), as steps from the reference.

A stage holds all variables of its interval, so that Hessian and constraints inside the interval belong to one stage.
Coupling rows make neighbours agree on the node that they share: the dynamics are soft rows, the others are hard. The
last stage is the last node alone: its variables U_{i+1} have no meaning. If a constraint is not convex, every stage
has one more variable, the virtual buffer, which relaxes it at a penalty: far from a solution, linearisations may be
infeasible.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.kinds import by_cone
from jaxscp.conic.program import Cones, ConicMultipliers, CouplingRows, HalfSpaceRows, StagedProgram
from jaxscp.core.errors import InvalidProblem
from jaxscp.problem.end_conditions import Condition
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.transcription.layout import cost_gradient
from jaxscp.transcription.shooting import Linearisation


def interval_program(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    hessian: Float[Array, "nodes inputs inputs"],
    gradient: Float[Array, "nodes inputs"],
    virtual_weight: float,
) -> StagedProgram:
    """The convex subproblem about z.

    Args:
        problem: to be solved.
        z: the reference.
        linear: linearisation about the reference.
        hessian: convex Hessian of every stage.
        gradient: added to the gradient of the cost.
        virtual_weight: penalty weight of virtual control and of the virtual buffer.
    """
    kinds = _by_cone(problem)
    rows = [_half_spaces(problem, i, z, linear) for i in kinds.nonnegative]
    rows.append(_node_limits(problem, z, hessian.shape[-1]))
    matrix, offset = (jnp.concatenate(part, axis=1) for part in zip(*rows, strict=True))
    program = StagedProgram(
        hessian=hessian,
        gradient=gradient + cost_gradient(problem, z, linear.jacobian.cost),
        links=_coupling(problem, z, linear, virtual_weight),
        rows=HalfSpaceRows(matrix, offset),
        cones=tuple(Cones(*_at_points(problem, i, z, linear)) for i in kinds.second_order),
    )
    if not has_buffer(problem):
        return program
    return _with_buffer(program, _buffered_rows(problem, linear), virtual_weight)


def has_buffer(problem: ScaledTimeProblem) -> bool:
    """Whether stages have a virtual buffer."""
    return not all(c.convex for c in problem.constraints)


def node_step(problem: ScaledTimeProblem, stages: Float[Array, "nodes _"]) -> Float[Array, "nodes _"]:
    """Step of the node variables, from the stages."""
    return stages[:, : problem.variables]


def nlp_multipliers(
    problem: ScaledTimeProblem, linear: Linearisation, found: ConicMultipliers
) -> Multipliers:
    """Multipliers of the nonlinear problem, from the multipliers of the subproblem's rows."""
    states, kinds = problem.state_size, _by_cone(problem)
    values: list = [None] * len(problem.constraints)
    first = 0
    for i in kinds.nonnegative:
        shape = linear.outputs.values[i].shape
        count = shape[1] * shape[2]
        values[i] = found.rows[:, first : first + count].reshape(-1, *shape[1:])
        first += count
    for i, y in zip(kinds.second_order, found.cones, strict=True):
        values[i] = y
    values = [y if c.where.nodal else y[:-1] for c, y in zip(problem.constraints, values, strict=True)]
    limits = found.rows[:, None, first : first + 2 + problem.slacks]
    return Multipliers(
        flow=found.links[1:-1, :states],
        initial=found.links[0, : linear.initial.value.shape[0]],
        final=found.links[-1, : linear.final.value.shape[0]],
        values=(*values, limits),
    )


def check(problem: ScaledTimeProblem) -> None:
    """Raise ``InvalidProblem`` for a problem without such a subproblem; the message names the constraint."""
    if problem.carries_cost:
        raise ValueError("carries_cost: this form keeps the running cost out of the states; leave it False")
    kinds = _by_cone(problem)
    for i, constraint in enumerate(problem.constraints):
        if i in kinds.zero:
            raise InvalidProblem(
                f"{constraint.name}: equality constraints on the path are not supported by this method; state it as "
                "a thin inequality, or as a boundary condition"
            )
        if not constraint.convex and i not in kinds.nonnegative:
            raise InvalidProblem(
                f"{constraint.name}: a constraint that is not convex must be of cone NonNegative()"
            )


def _by_cone(problem: ScaledTimeProblem):
    return by_cone(c.cone for c in problem.constraints)


def _coupling(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    virtual_weight: float,
) -> CouplingRows:
    """Rows between stages: the dynamics (soft), and the controls that two stages share (hard)."""
    n, stage = problem.state_size, problem.variables
    jacobian = linear.jacobian.end
    intervals, _, inputs = jacobian.shape
    defect = linear.outputs.end - z[1:, :n]
    initial, initial_rhs = _padded(linear.initial, stage, inputs)
    final, final_rhs = _padded(linear.final, stage, inputs)
    none = jnp.zeros((1, stage, inputs), z.dtype)
    shared = jnp.eye(stage - n, dtype=z.dtype)
    before = jnp.zeros((intervals, stage, inputs), z.dtype)
    before = before.at[:, :n].set(jacobian).at[:, n:, stage:].set(shared)
    after = jnp.broadcast_to(-jnp.eye(stage, inputs, dtype=z.dtype), before.shape)
    offset = jnp.zeros((intervals, stage), z.dtype).at[:, :n].set(-defect)
    soft = jnp.zeros((intervals + 2, stage), z.dtype).at[1:-1, : problem.dynamic_states].set(1.0)
    return CouplingRows(
        before=jnp.concatenate([none, before, final[None]]),
        after=jnp.concatenate([initial[None], after, none]),
        offset=jnp.concatenate([initial_rhs[None], offset, final_rhs[None]]),
        soft=soft,
        weight=jnp.full((intervals + 2,), virtual_weight, z.dtype),
    )


def _padded(condition: Condition, rows: int, inputs: int):
    """(matrix, right-hand side) of an end condition for a step, padded with rows of zeros."""
    matrix, value = condition.jacobian, condition.value
    pad = rows - value.shape[0]
    return jnp.pad(matrix, ((0, pad), (0, inputs - matrix.shape[1]))), jnp.pad(-value, (0, pad))


def _at_points(problem: ScaledTimeProblem, index: int, z, linear: Linearisation):
    """(matrix, offset) with offset - matrix w in the cone, (nodes, points, rows, ...).

    Inactive points get rows that always hold. The last node has no interval: its rows hold constraints at nodes alone;
    all others reach it through the interval before.
    """
    constraint = problem.constraints[index]
    values, jacobian = linear.outputs.values[index], linear.jacobian.values[index]
    inactive = constraint.cone.inactive_value(values[0, 0])
    active = constraint.active_in_intervals(values.shape[1])[:, :, None]
    matrix: Array = jnp.where(active[..., None], -jacobian, 0.0)
    offset: Array = jnp.where(active, values, inactive)
    last_matrix = jnp.zeros_like(matrix[:1])
    last_offset: Array = jnp.broadcast_to(inactive, offset[:1].shape)
    if constraint.where.nodal:
        last_matrix, last_offset = _at_last_node(problem, constraint, z[-1], last_matrix, last_offset)
    return jnp.concatenate([matrix, last_matrix]), jnp.concatenate([offset, last_offset])


def _at_last_node(problem: ScaledTimeProblem, constraint: PathConstraint, z, matrix: Array, offset: Array):
    """Rows of a constraint at the last node, in place of the given inactive ones."""
    parameters = jax.tree.map(lambda p: p[-1], constraint.node_parameters())
    states, stage = problem.state_size, problem.variables

    def value(v):
        return problem.value_at(constraint, v[:states], v[states:], parameters)

    active, jacobian, here = constraint.active_at_locations(1)[-1, 0], jax.jacfwd(value)(z), value(z)
    matrix = matrix.at[0, 0, :, :stage].set(jnp.where(active, -jacobian, 0.0))
    return matrix, offset.at[0, 0].set(jnp.where(active, here, offset[0, 0]))


def _half_spaces(problem: ScaledTimeProblem, index: int, z, linear: Linearisation):
    matrix, offset = _at_points(problem, index, z, linear)
    return matrix.reshape(problem.nodes, -1, matrix.shape[-1]), offset.reshape(problem.nodes, -1)


def _node_limits(problem: ScaledTimeProblem, z, inputs: int):
    jacobian = problem.node_limits_jacobian(z.dtype)
    matrix = -jnp.pad(jacobian, ((0, 0), (0, inputs - jacobian.shape[1])))
    return jnp.broadcast_to(matrix, (problem.nodes, *matrix.shape)), problem.node_limits(z)


def _buffered_rows(problem: ScaledTimeProblem, linear: Linearisation) -> Float[Array, "rows"]:
    """One for each row of a nonconvex constraint, zero for the others."""
    parts = [
        jnp.full(linear.outputs.values[i][0].size, float(not problem.constraints[i].convex))
        for i in _by_cone(problem).nonnegative
    ]
    return jnp.concatenate([*parts, jnp.zeros(2 + problem.slacks)])


def _with_buffer(program: StagedProgram, rows: Float[Array, "rows"], weight: float) -> StagedProgram:
    """The program with one more nonnegative variable a stage, added to the buffered rows at a penalty."""
    wider = lambda a, value=0.0: jnp.pad(  # noqa: E731
        a, [(0, 0)] * (a.ndim - 1) + [(0, 1)], constant_values=value
    )
    hessian = jnp.pad(program.hessian, ((0, 0), (0, 1), (0, 1)))
    matrix = wider(program.rows.matrix).at[:, :, -1].set(-rows)
    nonnegative = jnp.zeros_like(matrix[:, :1]).at[:, :, -1].set(-1.0)
    offset = jnp.pad(program.rows.offset, ((0, 0), (0, 1)))
    links = program.links
    return StagedProgram(
        hessian=hessian,
        gradient=wider(program.gradient, weight),
        links=CouplingRows(wider(links.before), wider(links.after), links.offset, links.soft, links.weight),
        rows=HalfSpaceRows(jnp.concatenate([matrix, nonnegative], axis=1), offset),
        cones=tuple(Cones(wider(c.matrix), c.offset) for c in program.cones),
    )
