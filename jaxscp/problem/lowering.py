"""From the problem that was asked to the problem over scaled time that is solved."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.program import reads
from jaxscp.core.types import Scalar
from jaxscp.problem.constraint import DISTANCE_TOLERANCE, AtNodes, Constraint
from jaxscp.problem.form import Form
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.problem.sizes import measured_sizes, size_of_constraint
from jaxscp.problem.time import FixedTime, FreeTime
from jaxscp.problem.trajectory import Trajectory


def over_scaled_time(
    problem: OptimalControlProblem, form: Form, guess: Trajectory | None = None
) -> ScaledTimeProblem:
    """The problem over scaled time, with as few states as it needs.

    Args:
        problem: of ``canonical``.
        form: that the method solves.
        guess: gives the weight of the mesh, and typical sizes of constraints if the problem has a scale.

    Raises:
        InvalidProblem: for a soft constraint that has no slack.
    """
    sizes = None
    if problem.scale is not None:
        assert guess is not None, "a problem with a scale needs its guess"
        sizes = measured_sizes(problem, problem.scale, guess)
    constraints = [*problem.constraints, *_limits_of_final_time(problem)]
    least, most = dilation_limits(problem)
    unit = 1.0 if sizes is None else sizes.time
    return ScaledTimeProblem(
        dynamics=problem.dynamics,
        cost=problem.cost,
        boundary=problem.boundary,
        constraints=_path_constraints(problem, constraints, guess),
        dilation_min=least / unit,
        dilation_max=most / unit,
        checks=_path_constraints(problem, list(problem.checks), guess),
        sizes=sizes,
        nodes=problem.time.nodes,
        carries_cost=form.carries_cost,
        carries_time=form.carries_time or len(constraints) > len(problem.constraints) or reads_time(problem),
        zero_order_hold=problem.zero_order_hold,
        curved_end=_reads_any(_terminal_gradient(problem)),
        mesh_weight=_mesh_weight(problem, guess, unit),
    )


def _mesh_weight(
    problem: OptimalControlProblem, guess: Trajectory | None, unit: Scalar | float
) -> Scalar | None:
    """Weight of the mesh, for dilations in the solver's unit of time."""
    time = problem.time
    if isinstance(time.final, FixedTime) or time.mesh_weight is None:
        return None
    if time.mesh_unit is not None:
        return time.mesh_weight * (unit / time.mesh_unit) ** 2
    if guess is None:
        return None
    return time.mesh_weight * (unit / jax.lax.stop_gradient(guess.time[-1])) ** 2


Reading = tuple[Callable[..., Any], int, tuple]
"""A function, the number of one of its arguments, and its arguments."""


def reads_time(problem: OptimalControlProblem) -> bool:
    """Whether time must be a state: a function depends on it, or the terminal cost does and is not affine in it.

    Terminal cost otherwise takes the final time from the dilation.
    """
    x, u = jnp.zeros(problem.dynamics.state_size), jnp.zeros(problem.dynamics.control_size)
    node = _of_one_node(problem.cost.node_parameters())
    functions: list[Reading] = [
        (problem.dynamics, 2, (x, u, 0.0)),
        (lambda x, u, t: problem.cost.running_at(x, u, t, node), 2, (x, u, 0.0)),
        (problem.boundary.final.value, 1, (x, 0.0)),
    ]
    functions += _terminal_gradient(problem)[:2]
    if problem.boundary.coupled is not None:
        functions.append((problem.boundary.coupled.value, 2, (x, x, 0.0)))
    for c in (*problem.constraints, *problem.checks):
        if not c.where.across:
            p = _of_one_node(c.node_parameters())
            functions.append((lambda x, u, t, c=c, p=p: c.value(x, u, t, p), 2, (x, u, 0.0)))
    return _reads_any(functions)


def _reads_any(functions: list[Reading]) -> bool:
    return any(reads(function, argument, *arguments) for function, argument, arguments in functions)


def _terminal_gradient(problem: OptimalControlProblem) -> list[Reading]:
    """Gradient of the terminal cost in time, by time and state; then in the state, by the state."""
    cost, x = problem.cost, jnp.zeros(problem.dynamics.state_size)
    node = _of_one_node(cost.node_parameters())
    in_time = jax.grad(lambda t, x: cost.terminal_at(x, t, node))
    in_state = jax.grad(lambda x, t: cost.terminal_at(x, t, node))
    return [(in_time, 0, (0.0, x)), (in_time, 1, (0.0, x)), (in_state, 0, (x, 0.0))]


def _of_one_node(parameters: Any) -> Any:
    return jax.tree.map(lambda v: v[0], parameters)


def dilation_limits(problem: OptimalControlProblem) -> tuple[Scalar, Scalar]:
    """Least and greatest dilation of a node, in s."""
    final = problem.time.final
    if isinstance(final, FixedTime):
        return final.duration, final.duration
    return (final.lower, final.upper) if final.dilation is None else final.dilation


def _within_time(state, control, time, limits) -> Float[Array, "2"]:
    """Final time between two limits."""
    return jnp.stack([time - limits[0], limits[1] - time])


def _limits_of_final_time(problem: OptimalControlProblem) -> list[Constraint]:
    """A constraint on the final time, where the limits of the dilation do not imply it."""
    final, nodes = problem.time.final, problem.time.nodes
    if not isinstance(final, FreeTime) or final.dilation is None:
        return []
    last = jnp.arange(nodes) == nodes - 1
    limits = final.lower, final.upper
    return [
        Constraint(
            _within_time, NonNegative(), limits, active=last, where=AtNodes(), convex=True, name="final time"
        )
    ]


def _path_constraints(
    problem: OptimalControlProblem, constraints: list[Constraint], guess: Trajectory | None
) -> tuple[PathConstraint, ...]:
    """The constraints with all fields filled in, and slacks numbered."""
    found, slacks = [], 0
    for c in constraints:
        size = None
        if problem.scale is not None and guess is not None:
            size = size_of_constraint(c, problem.scale, guess)
        active = jnp.ones(problem.time.nodes, bool) if c.active is None else c.active
        tolerance = c.tolerance
        if tolerance is None:
            tolerance = DISTANCE_TOLERANCE * (1.0 if size is None else size)
        fields = {field.name: getattr(c, field.name) for field in dataclasses.fields(Constraint)}
        fields |= {"active": active, "tolerance": jnp.asarray(tolerance, float)}
        slack, by_size = None, c.tolerance is None and size is not None and c.soft is None
        if c.soft is not None:
            if c.where.across or not c.cone.inequality:
                raise InvalidProblem(
                    f"{c.name}: a soft constraint must be an inequality at points, not across intervals or of cone "
                    "Zero()."
                )
            slack, slacks = slacks, slacks + 1
            fields["tolerance"] = jnp.full((), jnp.inf)
        found.append(PathConstraint(**fields, size=size, slack=slack, tolerance_by_size=by_size))
    return tuple(found)
