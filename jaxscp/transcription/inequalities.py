"""All inequalities of a problem, each at its locations: intervals, or nodes for constraints at nodes alone."""

from typing import cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative, SymmetricCone
from jaxscp.problem.scaled_time import PathConstraint, ScaledTimeProblem
from jaxscp.transcription.layout import sum_onto_nodes
from jaxscp.transcription.shooting import Linearisation, Outputs

OF_DILATION = 2  # of a node's own limits; the others are of slack variables

Values = tuple[Float[Array, "_ _ _"], ...]
"""(locations, points, rows) of every constraint, then (nodes, 1, limits): the ``node_limits``."""
Jacobians = tuple[Float[Array, "_ _ _ _"], ...]
"""With respect to the variables of an interval or node, which are the last axis."""


def cones(problem: ScaledTimeProblem) -> tuple[SymmetricCone, ...]:
    """The cone of each of ``inequalities``."""
    return (*(cast(SymmetricCone, c.cone) for c in problem.constraints), NonNegative())


def at_nodes(problem: ScaledTimeProblem) -> tuple[bool, ...]:
    """Whether the locations of each of ``inequalities`` are nodes."""
    return (*(c.where.nodal for c in problem.constraints), True)


def inequalities(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    outputs: Outputs,
    relaxation: float = 0.0,
) -> Values:
    """Values that lie in their cones, moved inwards by ``relaxation``; the identity where inactive.

    Slack variables and soft constraints are not moved: a slack could be negative, and earn its weight.
    """
    parts = []
    for constraint, cone, values in zip(problem.constraints, cones(problem), outputs.values, strict=False):
        if constraint.where.nodal:
            values = _at_nodes(problem, constraint, z)
        identity = cone.identity(values.shape[-1])
        active = constraint.active_at_locations(values.shape[1])[:, :, None]
        moved = values if constraint.slack is not None else values + relaxation * identity
        parts.append(jnp.where(active, moved, identity))
    limits = problem.node_limits(z)[:, None]
    of_dilation = jnp.arange(limits.shape[-1]) < OF_DILATION
    return (*parts, limits + jnp.where(of_dilation, relaxation, 0.0))


def jacobians(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], linear: Linearisation
) -> Jacobians:
    """Jacobians of ``inequalities``."""
    parts = []
    for constraint, jacobian in zip(problem.constraints, linear.jacobian.values, strict=True):
        if constraint.where.nodal:
            at = lambda v, p, c=constraint: _at_node(problem, c, v, p)  # noqa: E731
            jacobian = jax.vmap(jax.jacfwd(at))(z, constraint.node_parameters())
        active = constraint.active_at_locations(jacobian.shape[1])[:, :, None, None]
        parts.append(jnp.where(active, jacobian, 0.0))
    limits = problem.node_limits_jacobian(z.dtype)
    return (*parts, jnp.broadcast_to(limits, (z.shape[0], 1, *limits.shape)))


def last_node_hessian(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], multipliers: Values
) -> Float[Array, "variables variables"]:
    """Second derivatives of - y . g at the last node, of the constraints at nodes alone.

    Those at other nodes are among the second derivatives of the intervals that begin there.
    """
    total, last = jnp.zeros((z.shape[1], z.shape[1]), z.dtype), z.shape[0] - 1
    for constraint, y in zip(problem.constraints, multipliers[:-1], strict=True):
        if constraint.where.nodal:
            active = constraint.active_at_locations(1)[last, 0]
            parameters = jax.tree.map(lambda p: p[last], constraint.node_parameters())

            def product(v, c=constraint, p=parameters, y=y[last]):
                return -jnp.vdot(y, _at_node(problem, c, v, p))

            total += active.astype(z.dtype) * jax.hessian(product)(z[last])
    return total


def transpose_product(problem: ScaledTimeProblem, jacobians: Jacobians, multipliers: Values):
    """Sum of y' dg over all inequalities, by node variables."""
    total = jnp.zeros((problem.nodes, problem.variables), multipliers[-1].dtype)
    for jacobian, y, nodal in zip(jacobians, multipliers, at_nodes(problem), strict=True):
        product = jnp.sum(jacobian * y[..., None], axis=(1, 2))
        total += product if nodal else sum_onto_nodes(problem, product)
    return total


def _at_node(
    problem: ScaledTimeProblem, constraint: PathConstraint, v: Float[Array, "variables"], parameters
):
    n = problem.state_size
    return problem.value_at(constraint, v[:n], v[n:], parameters)[None]


def _at_nodes(problem: ScaledTimeProblem, constraint: PathConstraint, z: Float[Array, "nodes variables"]):
    return jax.vmap(lambda v, p: _at_node(problem, constraint, v, p))(z, constraint.node_parameters())
