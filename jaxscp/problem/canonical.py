"""A problem with programs for functions, and tuples of arrays for parameters.

Two problems with equal functions then have one tree structure, whatever objects the functions are, so that they share
compiled code. Functions of this package stay as they are: their names determine them.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxscp.core.errors import InvalidProblem
from jaxscp.core.program import Program, identify, of_this_package, wholly_of_this_package
from jaxscp.dynamics.base import Dynamics, FunctionDynamics
from jaxscp.problem.boundary import Boundary, EndRows
from jaxscp.problem.constraint import Constraint, name_of
from jaxscp.problem.cost import Cost
from jaxscp.problem.parts import check_parts
from jaxscp.problem.problem import OptimalControlProblem

_NUMBER = jax.ShapeDtypeStruct((), float)
_CONCRETE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.NonConcreteBooleanIndexError,
)
_NOT_PURE = (
    "it needs the values of its arguments, which JAX does not know yet. Call jnp, not np; in place of if, and, or, "
    "call jnp.where; keep out float(...) and int(...). JAX says: "
)


def canonical(problem: OptimalControlProblem) -> OptimalControlProblem:
    """The problem with programs for functions; its leaves are the same, in the same order.

    Functions that close over tracers (inside ``grad`` and ``vmap``) add those as leaves.

    Raises:
        InvalidProblem: if a function fails, or returns another shape than its part of the problem needs; the message
            names the part.
    """
    check_parts(problem)
    n, m = problem.dynamics.state_size, problem.dynamics.control_size
    x, u, nodes = jax.ShapeDtypeStruct((n,), float), jax.ShapeDtypeStruct((m,), float), problem.time.nodes
    found = [
        _constraint(_named(c, number), field, x, u, nodes)
        for number, (field, c) in enumerate(problem.named_constraints(), start=1)
    ]
    _unique_names(found)
    constraints, checks = found[: len(problem.constraints)], found[len(problem.constraints) :]
    return OptimalControlProblem(
        dynamics=_dynamics(problem.dynamics, x, u),
        cost=_cost(problem.cost, x, u, nodes),
        boundary=_boundary(problem.boundary, x),
        time=_with_arrays(problem.time, "time"),
        constraints=tuple(constraints),
        scale=_with_arrays(problem.scale, "scale"),
        checks=tuple(checks),
        zero_order_hold=tuple(problem.zero_order_hold),
    )


def as_array(value: Any, field: str) -> jax.Array:
    """A number or an array, in double precision and without a weak type."""
    if not isinstance(value, jax.Array):
        if not isinstance(value, bool | int | float | np.ndarray | np.generic):
            raise InvalidProblem(
                f"{field}: holds a {type(value).__name__}; parameters are numbers and arrays. Let the function close "
                "over other objects."
            )
        value = np.asarray(value)
        if value.ndim == 0 and np.issubdtype(value.dtype, np.integer):
            value = value.astype(float)  # a weight of 2 is one of 2.0
        value = jnp.asarray(value)
    if value.dtype not in (jnp.float64, jnp.int64, jnp.int32, jnp.bool_):
        raise InvalidProblem(
            f"{field}: expected float64, got {value.dtype}. Was the array made before jax_enable_x64 was set?"
        )
    return value


def _with_arrays(tree: Any, field: str) -> Any:
    """The pytree with arrays for numbers; known ones are checked."""

    def one(path, leaf):
        name = f"{field}{jax.tree_util.keystr(path)}"
        value = as_array(leaf, name)
        if not isinstance(value, Tracer) and np.isnan(np.asarray(value)).any():
            raise InvalidProblem(f"{name}: holds a value that is not a number (NaN).")
        return value

    return jax.tree_util.tree_map_with_path(one, tree)


def _program(
    function: Callable[..., Any], field: str, arguments: tuple, parameters: Any
) -> tuple[Program, tuple]:
    """The program of a function, and what it captures."""
    if not callable(function):
        raise InvalidProblem(f"{field}: expected a function, got a {type(function).__name__}.")
    try:
        return identify(function, *arguments, parameters)
    except Exception as error:
        words = ", ".join(str(v.shape) for v in arguments)
        raise InvalidProblem(
            f"{field}: {name_of(function) or 'the function'} fails for arguments of shapes {words} and its parameters: "
            f"{_NOT_PURE if isinstance(error, _CONCRETE) else ''}{error}"
        ) from error


def _identified(part: Any, field: str, arguments: tuple, example: Any, nodes: int | None = None) -> Any:
    """A part with a program for its function, and the shape of its values.

    Args:
        part: has the fields ``function`` and ``parameters``.
        field: its name.
        arguments: shapes of the function's arguments but the last.
        example: the last: parameters of one point.
        nodes: number of nodes if its parameters have them as leading axis.
    """
    if of_this_package(part.function):
        return part, _shape(part.function, field, arguments, example)
    program, captured = _program(part.function, field, arguments, example)
    captured = captured if nodes is None else _over_nodes(captured, nodes)
    leaves = (*captured, *jax.tree.leaves(part.parameters))
    return dataclasses.replace(part, function=program, parameters=leaves), program.shape


def _expect(found: tuple[int, ...], field: str, shape: tuple[int, ...], words: str) -> None:
    if found != shape:
        hint = " Take the entry: value[0]." if found == (1,) and shape == () else ""
        raise InvalidProblem(f"{field}: returns shape {found}, expected {shape}: {words}.{hint}")


def _dynamics(dynamics: Dynamics, x: Any, u: Any) -> Dynamics:
    dynamics = _with_arrays(dynamics, "dynamics")
    if wholly_of_this_package(dynamics):
        return dynamics
    arguments, words = (x, u, _NUMBER), "the derivative of each state"
    if isinstance(dynamics, FunctionDynamics):
        part, shape = _identified(dynamics, "dynamics", arguments, dynamics.parameters)
        _expect(shape, "dynamics", x.shape, words)
        return FunctionDynamics(part.function, x.shape[0], u.shape[0], part.parameters)
    parameters, tree = jax.tree.flatten(dynamics)

    def function(x, u, t, leaves):
        return jax.tree.unflatten(tree, leaves)(x, u, t)

    program, captured = _program(function, "dynamics", arguments, tuple(parameters))
    _expect(program.shape, "dynamics", x.shape, words)
    return FunctionDynamics(program, x.shape[0], u.shape[0], (*captured, *parameters))


def _cost(cost: Cost, x: Any, u: Any, nodes: int) -> Cost:
    cost = _with_arrays(cost, "cost")
    if of_this_package(cost.running) and of_this_package(cost.terminal):
        return cost
    example = _at_node(cost.parameters, nodes, "cost.parameters") if cost.per_node else cost.parameters
    running = _program(cost.running, "cost.running", (x, u, _NUMBER), example)
    terminal = _program(cost.terminal, "cost.terminal", (x, _NUMBER), example)
    for (program, _), field in ((running, "cost.running"), (terminal, "cost.terminal")):
        _expect(program.shape, field, (), "a cost is one number")
    leaves = tuple(jax.tree.leaves(cost.parameters))
    captured = [_over_nodes(c, nodes) if cost.per_node else c for _, c in (running, terminal)]
    if not any(captured):
        return Cost(running[0], terminal[0], leaves, cost.per_node)
    parts = [_OfPart(program, number) for number, (program, _) in enumerate((running, terminal))]
    return Cost(parts[0], parts[1], (*captured, leaves), cost.per_node)


class _OfPart(eqx.Module):
    """One of two programs that share their parameters, and capture tracers of their own."""

    program: Program = eqx.field(static=True)
    number: int = eqx.field(static=True)

    def __call__(self, *arguments):
        *first, parameters = arguments
        return self.program(*first, (*parameters[self.number], *parameters[-1]))


def _over_nodes(captured: tuple, nodes: int) -> tuple:
    return tuple(jnp.broadcast_to(c, (nodes, *jnp.shape(c))) for c in captured)


def _at_node(parameters: Any, nodes: int, field: str) -> Any:
    """Shapes of the parameters of one node."""

    def one(path, leaf):
        if leaf.shape[:1] != (nodes,):
            raise InvalidProblem(
                f"{field}{jax.tree_util.keystr(path)}: per_node arrays have the {nodes} nodes as leading axis, but "
                f"this one has shape {leaf.shape}."
            )
        return jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype)

    return jax.tree_util.tree_map_with_path(one, parameters)


def _named(c: Constraint, number: int) -> Constraint:
    return dataclasses.replace(c, name=c.name or name_of(c.function) or f"constraint {number}")


def _constraint(c: Constraint, place: str, x: Any, u: Any, nodes: int) -> Constraint:
    field = f"{place} ({c.name})"
    c = _with_arrays(c, field)
    if c.active is not None and (c.active.shape != (nodes,) or c.active.dtype != bool):
        raise InvalidProblem(
            f"{field}.active: expected flags of shape ({nodes},), True or False for each node; got {c.active.dtype} of "
            f"shape {c.active.shape}."
        )
    example = _at_node(c.parameters, nodes, f"{field}.parameters") if c.per_node else c.parameters
    across = jax.ShapeDtypeStruct((u.shape[0] + 1,), float)
    arguments = (across, across, _NUMBER) if c.where.across else (x, u, _NUMBER)
    c, shape = _identified(c, field, arguments, example, nodes if c.per_node else None)
    if len(shape) != 1 or shape[0] < c.cone.least_rows:
        rows = (
            "one axis of values"
            if c.cone.least_rows == 1
            else f"one axis of {c.cone.least_rows} values or more"
        )
        raise InvalidProblem(
            f"{field}: returns shape {shape}, but {type(c.cone).__name__}() holds {rows}."
            + (" Return jnp.stack([value])." if shape == () else "")
        )
    return c


def _shape(function: Callable[..., Any], field: str, arguments: tuple, parameters: Any) -> tuple[int, ...]:
    """Shape of the values of a function of this package."""
    leaves, tree = jax.tree.flatten(parameters)
    shapes = tuple((*v.shape, str(v.dtype)) for v in leaves)
    sizes = tuple(v.shape for v in arguments)
    try:
        return _shape_of(function, sizes, tree, shapes)
    except Exception as error:
        words = " and ".join(map(str, sizes[:2]))
        raise InvalidProblem(
            f"{field}: does not fit a state and a control of shapes {words}: {error}"
        ) from error


@functools.lru_cache(maxsize=1024)
def _shape_of(function: Callable[..., Any], sizes: tuple, tree: Any, shapes: tuple) -> tuple[int, ...]:
    leaves = [jax.ShapeDtypeStruct(shape, dtype) for *shape, dtype in shapes]
    arguments = [jax.ShapeDtypeStruct(size, float) for size in sizes]
    return jax.eval_shape(function, *arguments, jax.tree.unflatten(tree, leaves)).shape


def _boundary(boundary: Boundary, x: Any) -> Boundary:
    coupled = boundary.coupled
    return Boundary(
        _ends(boundary.initial, "boundary.initial", (x, _NUMBER)),
        _ends(boundary.final, "boundary.final", (x, _NUMBER)),
        None if coupled is None else _ends(coupled, "boundary.coupled", (x, x, _NUMBER)),
    )


def _ends(condition: Any, field: str, arguments: tuple) -> Any:
    condition = _with_arrays(condition, field)
    name = name_of(condition.function) or field.rpartition(".")[2]
    condition, shape = _identified(condition, field, arguments, condition.parameters)
    if len(shape) != 1:
        raise InvalidProblem(f"{field}: returns shape {shape}, expected one axis of rows.")
    rows = condition.rows or ((EndRows(name, count=shape[0]),) if shape[0] else ())
    if sum(r.count for r in rows) != shape[0]:
        raise InvalidProblem(
            f"{field}: returns {shape[0]} rows, but rows names {sum(r.count for r in rows)} of them."
        )
    return dataclasses.replace(condition, rows=rows)


def _unique_names(constraints: list[Constraint]) -> None:
    names = [c.name for c in constraints]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidProblem(
            f"constraints: the name {twice[0]!r} occurs {names.count(twice[0])} times; give each a name of its own."
        )
