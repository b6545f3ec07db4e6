"""Every inequality of a problem, each at its places: intervals, or nodes for what holds at nodes alone."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import Cone, NonNegative, SecondOrder
from jaxscp.problem.constraint import AtNodes, Constraint
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.transcription.layout import onto_nodes
from jaxscp.transcription.shooting import Linearisation, Outputs, active_points, value_at

Values = tuple[Float[Array, "_ _ _"], ...]
"""(places, points, rows) of every constraint, then (nodes, 1, 2): the limits of every node's dilation."""
Jacobians = tuple[Float[Array, "_ _ _ _"], ...]
"""With respect to an interval's variables, or a node's; these come last."""


def cones(problem: OptimalControlProblem) -> tuple[Cone, ...]:
    """The cone of each of ``inequalities``."""
    return (*(c.cone for c in problem.constraints), NonNegative())


def at_nodes(problem: OptimalControlProblem) -> tuple[bool, ...]:
    """Whether the places of each of ``inequalities`` are nodes."""
    return (*(isinstance(c.where, AtNodes) for c in problem.constraints), True)


def inequalities(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], outputs: Outputs, room: float = 0.0
) -> Values:
    """Values that lie in their cones, ``room`` added; the unit of the cone where a constraint says nothing."""
    parts = []
    for constraint, values in zip(problem.constraints, outputs.values, strict=True):
        if isinstance(constraint.where, AtNodes):
            values = _at_nodes(problem, constraint, z)
        inside = unit(constraint.cone, values.shape[-1])
        on = _active(constraint, values.shape[1])[:, :, None]
        parts.append(jnp.where(on, values + room * inside, inside))
    limits = jnp.stack([z[:, -1] - problem.dilation_min, problem.dilation_max - z[:, -1]], axis=1)
    return (*parts, limits[:, None] + room)


def jacobians(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], linear: Linearisation
) -> Jacobians:
    """Of ``inequalities``."""
    parts = []
    for constraint, jacobian in zip(problem.constraints, linear.jacobian.values, strict=True):
        if isinstance(constraint.where, AtNodes):
            at = lambda v, p, c=constraint: _at_node(problem, c, v, p)  # noqa: E731
            jacobian = jax.vmap(jax.jacfwd(at))(z, constraint.parameters)
        on = _active(constraint, jacobian.shape[1])[:, :, None, None]
        parts.append(jnp.where(on, jacobian, 0.0))
    upward = jnp.zeros(z.shape[1], z.dtype).at[-1].set(1.0)
    limits = jnp.broadcast_to(jnp.stack([upward, -upward]), (z.shape[0], 1, 2, z.shape[1]))
    return (*parts, limits)


def node_hessians(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], prices: Values
) -> Float[Array, "nodes variables variables"]:
    """Second derivatives of - y . g, for what holds at nodes alone."""
    total = jnp.zeros((*z.shape, z.shape[1]), z.dtype)
    for constraint, y in zip(problem.constraints, prices[:-1], strict=True):
        if isinstance(constraint.where, AtNodes):
            on = constraint.active[:, None, None]

            def product(v, p, y, c=constraint):
                return -jnp.vdot(y, _at_node(problem, c, v, p))

            total += on.astype(z.dtype) * jax.vmap(jax.hessian(product))(z, constraint.parameters, y)
    return total


def unit(cone: Cone, rows: int) -> Float[Array, "rows"]:
    """The identity of a cone's Jordan algebra: well inside it."""
    return jnp.zeros(rows).at[0].set(1.0) if isinstance(cone, SecondOrder) else jnp.ones(rows)


def pulled(problem: OptimalControlProblem, jacobians: Jacobians, prices: Values):
    """Sum of y' dg over all inequalities, by nodes."""
    total = jnp.zeros((problem.nodes, problem.variables), prices[-1].dtype)
    for jacobian, y, nodal in zip(jacobians, prices, at_nodes(problem), strict=True):
        pull = jnp.sum(jacobian * y[..., None], axis=(1, 2))
        total += pull if nodal else onto_nodes(problem, pull)
    return total


def _at_node(
    problem: OptimalControlProblem, constraint: Constraint, v: Float[Array, "variables"], parameters
):
    n = problem.state_size
    return value_at(problem, constraint, v[:n], v[n:], parameters)[None]


def _at_nodes(problem: OptimalControlProblem, constraint: Constraint, z: Float[Array, "nodes variables"]):
    return jax.vmap(lambda v, p: _at_node(problem, constraint, v, p))(z, constraint.parameters)


def _active(constraint: Constraint, points: int):
    """(places, points): where a constraint holds."""
    if isinstance(constraint.where, AtNodes):
        return constraint.active[:, None]
    return active_points(constraint, points)
