"""A first guess: a straight line in the state space."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxscp.core.arrays import is_number, namespace
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.types import Scalar
from jaxscp.problem.boundary import fixed_values
from jaxscp.problem.bounds import control_bounds
from jaxscp.problem.parts import check_parts
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FixedTime
from jaxscp.problem.trajectory import Trajectory


def straight_line(
    problem: OptimalControlProblem, final_time: Scalar | float | None = None, control: Any = None
) -> Trajectory:
    """States on a straight line between the ends, under constant controls.

    A component that is free at one end has the value of the other end; one that is free at both is zero.

    Args:
        problem: whose ends are given by ``fixed_state``.
        final_time: in s; by default the fixed duration, or the geometric mean of a free time's limits.
        control: (controls,) at every node, the thrusts of hover, say; by default as near zero as the bounds allow.

    Raises:
        InvalidProblem: for an end given by a function, which has no value to start from. Also for another number of
            controls, and for an end or a final time that is not finite. The message names the field.

    Example:
        >>> import jaxscp
        >>> problem = jaxscp.OptimalControlProblem(
        ...     dynamics=jaxscp.DoubleIntegrator(1),
        ...     cost=jaxscp.Cost(terminal=lambda x, t, p: t),
        ...     boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([1.0, None])),
        ...     time=jaxscp.Time(nodes=3, final=jaxscp.FreeTime(1.0, 4.0)),
        ... )
        >>> jaxscp.straight_line(problem).state.tolist()
        [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]
    """
    check_parts(problem)
    nodes = problem.time.nodes
    ends = [_end(problem, where) for where in ("initial", "final")]
    if final_time is not None and _known(final_time):
        if not is_number(final_time):
            raise InvalidProblem(f"final_time: expected one number, in s, got {final_time!r}.")
        if not (np.isfinite(final_time) and final_time > 0.0):
            raise InvalidProblem(f"final_time: must be positive and finite, got {final_time}.")
    pairs = [_both(first, last) for first, last in zip(*ends, strict=True)]
    xp = namespace(pairs)
    first, last = (xp.asarray(end, float) for end in zip(*pairs, strict=True))
    fraction = np.linspace(0.0, 1.0, nodes)[:, None]
    state = (1.0 - fraction) * first + fraction * last
    duration = _duration(problem) if final_time is None else final_time
    time = jnp.linspace(0.0, 1.0, nodes) * duration
    dilation = jnp.broadcast_to(jnp.asarray(duration, float), (nodes,))
    return Trajectory(time, jnp.asarray(state), _controls(problem, control), dilation)


def _end(problem: OptimalControlProblem, where: str) -> list[Any]:
    """Values of the state at an end, None where free."""
    condition = getattr(problem.boundary, where)
    values = fixed_values(condition, problem.dynamics.state_size)
    if values is None:
        names = ", ".join(rows.name for rows in condition.rows) or "its rows"
        raise InvalidProblem(
            f"boundary.{where}: {names} are given by a function, so that a straight line has no end there. Give a "
            "guess by Trajectory.from_arrays(times, states, controls)."
        )
    for i, value in enumerate(values):
        if value is not None and _known(value) and not np.isfinite(value):
            raise InvalidProblem(f"boundary.{where}: x[{i}] is fixed at {value}; None leaves it free.")
    return values


def _known(value: Any) -> bool:
    return not isinstance(value, Tracer)


def _both(first: Any, last: Any) -> tuple[Any, Any]:
    if first is None and last is None:
        return 0.0, 0.0
    return (last if first is None else first), (first if last is None else last)


def _duration(problem: OptimalControlProblem) -> Scalar:
    final = problem.time.final
    return final.duration if isinstance(final, FixedTime) else jnp.sqrt(final.lower * final.upper)


def _controls(problem: OptimalControlProblem, given: Any) -> jax.Array:
    """The given control; else zero, or the nearest value within the bounds, at every node."""
    size = problem.dynamics.control_size
    try:
        control = jnp.zeros(size) if given is None else jnp.asarray(given, float)
    except (TypeError, ValueError) as error:
        raise InvalidProblem(f"control: expected {size} numbers, got {given!r}.") from error
    if control.shape != (size,):
        raise InvalidProblem(f"control: expected {size} values, one for each control, got {control.shape}.")
    for constraint in problem.constraints if given is None else ():
        for side, limit in control_bounds(constraint):
            chosen = slice(None) if side.chosen is None else jnp.array(side.chosen, int)
            control = control.at[chosen].min(limit) if side.upper else control.at[chosen].max(limit)
    return jnp.broadcast_to(control, (problem.time.nodes, size))
