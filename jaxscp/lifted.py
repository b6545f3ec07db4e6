"""The subproblem over intervals: a chain of stages w_i = (x_i, U_i, U_{i+1}), as steps from the reference.

Each stage holds all that its interval depends on, so that curvature and constraints inside the interval are the
stage's own; neighbours agree on the node they share by the links, whose dynamics are soft and the rest hard.
The last stage is the last node alone; its third part is idle.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic.program import Cones, Links, Multipliers, Rows, StagedProgram
from jaxscp.constraints import NonNegative, SecondOrder, Zero
from jaxscp.convexify import terminal_cost
from jaxscp.intervals import Linearisation, active_points
from jaxscp.lagrangian import PathMultipliers
from jaxscp.problem import Boundary, OptimalControlProblem


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
        virtual_weight: price of virtual control.
    """
    rows = [_rows(problem, c, i, z, linear) for i, c in _of_kind(problem, NonNegative)]
    rows.append(_dilation_limits(problem, z, hessian.shape[-1]))
    return StagedProgram(
        hessian=hessian,
        gradient=gradient + _cost_gradient(problem, z, linear),
        links=_links(problem, z, linear, virtual_weight),
        rows=Rows(*(jnp.concatenate(part, axis=1) for part in zip(*rows, strict=True))),
        cones=tuple(_cones(c, i, linear) for i, c in _of_kind(problem, SecondOrder)),
    )


def node_step(problem: OptimalControlProblem, stages: Float[Array, "nodes inputs"]):
    """The step of the node variables that stages stand for."""
    return stages[:, : problem.variables]


def path_multipliers(
    problem: OptimalControlProblem, linear: Linearisation, found: Multipliers
) -> PathMultipliers:
    """A subproblem's multipliers in the nonlinear problem's own shape."""
    states = problem.state_size
    values: list = [None] * len(problem.constraints)
    first = 0
    for i, _ in _of_kind(problem, NonNegative):
        shape = linear.outputs.values[i].shape
        count = shape[1] * shape[2]
        values[i] = found.rows[:-1, first : first + count].reshape(shape)
        first += count
    for (i, _), y in zip(_of_kind(problem, SecondOrder), found.cones, strict=True):
        values[i] = y[:-1]
    dilation = jnp.max(found.rows[:, -2:], axis=1)
    return PathMultipliers(found.links[1:-1, :states], tuple(values), dilation)


def check(problem: OptimalControlProblem) -> None:
    """Raise for a problem that has no such form yet."""
    if problem.extended:
        raise ValueError(
            "extended: this form keeps elapsed cost and time out of the states; use extended=False"
        )
    for _, constraint in _of_kind(problem, Zero):
        raise ValueError(f"{constraint.name}: equality constraints inside intervals are not supported")


def _of_kind(problem: OptimalControlProblem, kind: type):
    return [(i, c) for i, c in enumerate(problem.constraints) if isinstance(c.cone, kind)]


def _cost_gradient(problem: OptimalControlProblem, z, linear: Linearisation) -> Float[Array, "nodes inputs"]:
    terminal = jax.grad(lambda z: terminal_cost(problem, z))(z)
    idle = linear.jacobian.cost.shape[1] - problem.variables
    return jnp.pad(terminal, ((0, 0), (0, idle))).at[:-1].add(linear.jacobian.cost)


def _rows(problem: OptimalControlProblem, constraint, index: int, z, linear: Linearisation):
    """(matrix, offset) of half-spaces at the points; the last node's are those of the controls alone."""
    values, jacobian = linear.outputs.values[index], linear.jacobian.values[index]
    intervals, points, _ = values.shape
    active = active_points(constraint, points)[:, :, None]
    matrix = jnp.where(active[..., None], -jacobian, 0.0).reshape(intervals, -1, jacobian.shape[-1])
    offset = jnp.where(active, values, 1.0).reshape(intervals, -1)
    last_matrix, last_offset = jnp.zeros_like(matrix[:1]), jnp.ones_like(offset[:1])
    if constraint.of_controls:
        parameters = jax.tree.map(lambda p: p[-1], constraint.parameters)
        state, _, control, _ = problem.split(z[-1])
        at = lambda u: constraint.function(state, u, None, parameters)  # noqa: E731
        columns = slice(problem.state_size, problem.variables - 1)
        on = constraint.active[-1]
        last_matrix = last_matrix.at[0, :, columns].set(jnp.where(on, -jax.jacfwd(at)(control), 0.0))
        value: Array = at(control)
        last_offset = jnp.where(on, value, 1.0)[None]
    return jnp.concatenate([matrix, last_matrix]), jnp.concatenate([offset, last_offset])


def _cones(constraint, index: int, linear: Linearisation) -> Cones:
    values, jacobian = linear.outputs.values[index], linear.jacobian.values[index]
    active = active_points(constraint, values.shape[1])[:, :, None]
    idle = jnp.zeros_like(values[0, 0]).at[0].set(1.0)
    matrix = jnp.where(active[..., None], -jacobian, 0.0)
    offset = jnp.where(active, values, idle)
    last = jnp.broadcast_to(idle, (1, *offset.shape[1:]))
    return Cones(jnp.concatenate([matrix, jnp.zeros_like(matrix[:1])]), jnp.concatenate([offset, last]))


def _dilation_limits(problem: OptimalControlProblem, z, inputs: int):
    unit = jnp.zeros(inputs, z.dtype).at[problem.variables - 1].set(1.0)
    matrix = jnp.broadcast_to(jnp.stack([-unit, unit]), (problem.nodes, 2, inputs))
    return matrix, jnp.stack([z[:, -1] - problem.dilation_min, problem.dilation_max - z[:, -1]], axis=1)


def _links(problem: OptimalControlProblem, z, linear: Linearisation, virtual_weight: float) -> Links:
    """Row blocks of each link: the dynamics (soft), and the controls that two stages share (hard)."""
    n, stage = problem.state_size, problem.variables
    jacobian = linear.jacobian.end
    intervals, _, inputs = jacobian.shape
    defect = linear.outputs.end - z[1:, :n]
    initial, initial_right = _boundary(problem.initial, z[0, :n], stage, inputs)
    final, final_right = _boundary(problem.final, z[-1, :n], stage, inputs)
    none = jnp.zeros((1, stage, inputs), z.dtype)
    shared = jnp.eye(stage - n, dtype=z.dtype)
    before = jnp.zeros((intervals, stage, inputs), z.dtype)
    before = before.at[:, :n].set(jacobian).at[:, n:, stage:].set(shared)
    after = jnp.broadcast_to(-jnp.eye(stage, inputs, dtype=z.dtype), before.shape)
    offset = jnp.zeros((intervals, stage), z.dtype).at[:, :n].set(-defect)
    soft = jnp.zeros((intervals + 2, stage), z.dtype).at[1:-1, :n].set(1.0)
    return Links(
        before=jnp.concatenate([none, before, final[None]]),
        after=jnp.concatenate([initial[None], after, none]),
        offset=jnp.concatenate([initial_right[None], offset, final_right[None]]),
        soft=soft,
        weight=jnp.full((intervals + 2,), virtual_weight, z.dtype),
    )


def _boundary(boundary: Boundary, state, rows: int, inputs: int):
    """(matrix, right-hand side) for a step of the state, padded with rows that say nothing."""
    matrix, value = boundary_condition(boundary, state)
    pad = rows - value.shape[0]
    return jnp.pad(matrix, ((0, pad), (0, inputs - state.shape[0]))), jnp.pad(-value, (0, pad))


def boundary_condition(boundary: Boundary, state: Float[Array, "states"]):
    """Jacobian and value of an end's conditions."""
    condition = lambda x: boundary.function(x, None, boundary.parameters)  # noqa: E731
    return jax.jacfwd(condition)(state), condition(state)
