"""The subproblem over intervals: a chain of stages w_i = (x_i, U_i, U_{i+1}), as steps from the reference.

Each stage holds all that its interval depends on, so that curvature and constraints inside the interval are the
stage's own; neighbours agree on the node they share by the links, whose dynamics are soft and the rest hard.
The last stage is the last node alone; its third part is idle. Where a constraint is not convex, one more variable a
stage, the virtual buffer, buys violations of it: a linearisation far from a solution may ask for too much.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative, SecondOrder, Zero
from jaxscp.conic.program import Cones, ConicMultipliers, CouplingRows, HalfSpaceRows, StagedProgram
from jaxscp.problem.constraint import AtNodes, Constraint
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import Condition, OptimalControlProblem
from jaxscp.transcription.layout import cost_gradient
from jaxscp.transcription.shooting import Linearisation, active_points, value_at


def lifted_program(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    hessian: Float[Array, "nodes inputs inputs"],
    gradient: Float[Array, "nodes inputs"],
    virtual_weight: float,
) -> StagedProgram:
    """The convex subproblem about z.

    Args:
        problem: what is asked.
        z: the reference.
        linear: its intervals, linearised.
        hessian: convex curvature of every stage.
        gradient: what is added to the gradient of the cost.
        virtual_weight: price of virtual control and of the virtual buffer.
    """
    rows = [_rows(problem, c, i, z, linear) for i, c in _of_kind(problem, NonNegative)]
    rows.append(_dilation_limits(problem, z, hessian.shape[-1]))
    matrix, offset = (jnp.concatenate(part, axis=1) for part in zip(*rows, strict=True))
    program = StagedProgram(
        hessian=hessian,
        gradient=gradient + cost_gradient(problem, z, linear.jacobian.cost),
        links=lifted_links(problem, z, linear, virtual_weight),
        rows=HalfSpaceRows(matrix, offset),
        cones=tuple(_cones(problem, c, i, z, linear) for i, c in _of_kind(problem, SecondOrder)),
    )
    return (
        _with_buffer(program, _buffered_rows(problem, linear), virtual_weight)
        if buffered(problem)
        else program
    )


def buffered(problem: OptimalControlProblem) -> bool:
    """Whether stages have a virtual buffer."""
    return not all(c.convex for c in problem.constraints)


def node_step(problem: OptimalControlProblem, stages: Float[Array, "nodes _"]):
    """The step of the node variables that stages stand for."""
    return stages[:, : problem.variables]


def flight_multipliers(
    problem: OptimalControlProblem, linear: Linearisation, found: ConicMultipliers
) -> Multipliers:
    """A subproblem's multipliers in the nonlinear problem's own shape."""
    states = problem.state_size
    values: list = [None] * len(problem.constraints)
    first = 0
    for i, _ in _of_kind(problem, NonNegative):
        shape = linear.outputs.values[i].shape
        count = shape[1] * shape[2]
        values[i] = found.rows[:, first : first + count].reshape(-1, *shape[1:])
        first += count
    for (i, _), y in zip(_of_kind(problem, SecondOrder), found.cones, strict=True):
        values[i] = y
    values = [
        y if isinstance(c.where, AtNodes) else y[:-1]
        for c, y in zip(problem.constraints, values, strict=True)
    ]
    dilation = found.rows[:, None, first : first + 2]
    return Multipliers(
        flow=found.links[1:-1, :states],
        initial=found.links[0, : linear.initial.value.shape[0]],
        final=found.links[-1, : linear.final.value.shape[0]],
        values=(*values, dilation),
    )


def check(problem: OptimalControlProblem) -> None:
    """Raise for a problem that has no such form."""
    if problem.carries_cost:
        raise ValueError("carries_cost: this form keeps the running cost out of the states; leave it False")
    for i, constraint in enumerate(problem.constraints):
        if isinstance(constraint.cone, Zero):
            raise ValueError(
                f"{constraint.name}: equality constraints on the path are not supported by this method; state it as "
                "a thin inequality, or as a boundary condition"
            )
        if not constraint.convex and i not in [j for j, _ in _of_kind(problem, NonNegative)]:
            raise ValueError(
                f"{constraint.name}: a constraint that is not convex must be of cone NonNegative()"
            )


def lifted_links(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    linear: Linearisation,
    virtual_weight: float,
) -> CouplingRows:
    """Row blocks of each link: the dynamics (soft), and the controls that two stages share (hard)."""
    n, stage = problem.state_size, problem.variables
    jacobian = linear.jacobian.end
    intervals, _, inputs = jacobian.shape
    defect = linear.outputs.end - z[1:, :n]
    initial, initial_right = _padded(linear.initial, stage, inputs)
    final, final_right = _padded(linear.final, stage, inputs)
    none = jnp.zeros((1, stage, inputs), z.dtype)
    shared = jnp.eye(stage - n, dtype=z.dtype)
    before = jnp.zeros((intervals, stage, inputs), z.dtype)
    before = before.at[:, :n].set(jacobian).at[:, n:, stage:].set(shared)
    after = jnp.broadcast_to(-jnp.eye(stage, inputs, dtype=z.dtype), before.shape)
    offset = jnp.zeros((intervals, stage), z.dtype).at[:, :n].set(-defect)
    soft = jnp.zeros((intervals + 2, stage), z.dtype).at[1:-1, : problem.dynamics.state_size].set(1.0)
    return CouplingRows(
        before=jnp.concatenate([none, before, final[None]]),
        after=jnp.concatenate([initial[None], after, none]),
        offset=jnp.concatenate([initial_right[None], offset, final_right[None]]),
        soft=soft,
        weight=jnp.full((intervals + 2,), virtual_weight, z.dtype),
    )


def _padded(condition: Condition, rows: int, inputs: int):
    """(matrix, right-hand side) for a step of the state, padded with rows that say nothing."""
    matrix, value = condition.jacobian, condition.value
    pad = rows - value.shape[0]
    return jnp.pad(matrix, ((0, pad), (0, inputs - matrix.shape[1]))), jnp.pad(-value, (0, pad))


def _of_kind(problem: OptimalControlProblem, kind: type):
    return [(i, c) for i, c in enumerate(problem.constraints) if isinstance(c.cone, kind)]


def _at_points(
    problem: OptimalControlProblem, constraint: Constraint, index: int, z, linear: Linearisation, idle: Array
):
    """(matrix, offset) with offset - matrix w in the cone, (nodes, points, rows, ...); ``idle`` where it says nothing.

    The last node has no interval: it obeys what holds at nodes alone, and all else through the interval before.
    """
    values, jacobian = linear.outputs.values[index], linear.jacobian.values[index]
    active = active_points(constraint, values.shape[1])[:, :, None]
    matrix: Array = jnp.where(active[..., None], -jacobian, 0.0)
    offset: Array = jnp.where(active, values, idle)
    last_matrix = jnp.zeros_like(matrix[:1])
    last_offset: Array = jnp.broadcast_to(idle, offset[:1].shape)
    if isinstance(constraint.where, AtNodes):
        parameters = jax.tree.map(lambda p: p[-1], constraint.parameters)
        states, stage = problem.state_size, problem.variables

        def value(v):
            return value_at(problem, constraint, v[:states], v[states:], parameters)

        on, slope, here = constraint.active[-1], jax.jacfwd(value)(z[-1]), value(z[-1])
        last_matrix = last_matrix.at[0, 0, :, :stage].set(jnp.where(on, -slope, 0.0))
        last_offset = last_offset.at[0, 0].set(jnp.where(on, here, idle))
    return jnp.concatenate([matrix, last_matrix]), jnp.concatenate([offset, last_offset])


def _rows(problem: OptimalControlProblem, constraint: Constraint, index: int, z, linear: Linearisation):
    idle = jnp.ones_like(linear.outputs.values[index][0, 0])
    matrix, offset = _at_points(problem, constraint, index, z, linear, idle)
    return matrix.reshape(problem.nodes, -1, matrix.shape[-1]), offset.reshape(problem.nodes, -1)


def _cones(
    problem: OptimalControlProblem, constraint: Constraint, index: int, z, linear: Linearisation
) -> Cones:
    idle = jnp.zeros_like(linear.outputs.values[index][0, 0]).at[0].set(1.0)
    return Cones(*_at_points(problem, constraint, index, z, linear, idle))


def _dilation_limits(problem: OptimalControlProblem, z, inputs: int):
    unit = jnp.zeros(inputs, z.dtype).at[problem.variables - 1].set(1.0)
    matrix = jnp.broadcast_to(jnp.stack([-unit, unit]), (problem.nodes, 2, inputs))
    return matrix, jnp.stack([z[:, -1] - problem.dilation_min, problem.dilation_max - z[:, -1]], axis=1)


def _buffered_rows(problem: OptimalControlProblem, linear: Linearisation) -> Float[Array, "rows"]:
    """One for each row of a constraint that is not convex, zero for the others."""
    parts = [
        jnp.full(linear.outputs.values[i][0].size, float(not c.convex))
        for i, c in _of_kind(problem, NonNegative)
    ]
    return jnp.concatenate([*parts, jnp.zeros(2)])


def _with_buffer(program: StagedProgram, rows: Float[Array, "rows"], weight: float) -> StagedProgram:
    """One more variable a stage, zero or more, that is added to the buffered rows at a price."""
    wider = lambda a, value=0.0: jnp.pad(  # noqa: E731
        a, [(0, 0)] * (a.ndim - 1) + [(0, 1)], constant_values=value
    )
    hessian = jnp.pad(program.hessian, ((0, 0), (0, 1), (0, 1)))
    matrix = wider(program.rows.matrix).at[:, :, -1].set(-rows)
    no_less = jnp.zeros_like(matrix[:, :1]).at[:, :, -1].set(-1.0)
    offset = jnp.pad(program.rows.offset, ((0, 0), (0, 1)))
    links = program.links
    return StagedProgram(
        hessian=hessian,
        gradient=wider(program.gradient, weight),
        links=CouplingRows(wider(links.before), wider(links.after), links.offset, links.soft, links.weight),
        rows=HalfSpaceRows(jnp.concatenate([matrix, no_less], axis=1), offset),
        cones=tuple(Cones(wider(c.matrix), c.offset) for c in program.cones),
    )
