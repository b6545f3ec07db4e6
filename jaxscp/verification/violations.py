"""Violations of a constraint along a trajectory and its rollout, and the tolerance that they are measured by."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Scalar
from jaxscp.problem.constraint import DISTANCE_TOLERANCE
from jaxscp.problem.scaled_time import PathConstraint
from jaxscp.problem.sizes import Sizes
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.rollout import Rollout

LEAST_TOLERANCE = 1e-6  # of the usual one, where the values' slope vanishes


def violations_of(
    constraint: PathConstraint, trajectory: Trajectory, integrated: Rollout, sizes: Sizes | None
) -> tuple[Scalar, Scalar, Scalar]:
    """Worst violation at the nodes, and wherever the constraint must hold; and the violation that counts as none."""
    if constraint.where.across:
        across = _worst_across(constraint, trajectory)
        return _in_one_unit(across, across, constraint.tolerance)
    at_nodes, _ = _worst(constraint, _planned_nodes(trajectory))
    where = _integrated_nodes(trajectory, integrated) if constraint.where.nodal else integrated
    between, place = _worst(constraint, where)
    tolerance = constraint.tolerance
    if sizes is not None and constraint.tolerance_by_size:
        tolerance = _tolerance_there(constraint, where, place, sizes)
    return _in_one_unit(at_nodes, between, tolerance)


def _planned_nodes(trajectory: Trajectory) -> Rollout:
    return Rollout(trajectory.time[:, None], trajectory.state[:, None], trajectory.control[:, None])


def _integrated_nodes(trajectory: Trajectory, integrated: Rollout) -> Rollout:
    """The nodes of the rollout."""
    state = jnp.concatenate([integrated.state[:, :1], integrated.state[-1:, -1:]])
    return Rollout(trajectory.time[:, None], state, trajectory.control[:, None])


def _violation(constraint: PathConstraint, state, control, time, parameters) -> Float[Array, "conditions"]:
    return constraint.cone.violations(constraint.value(state, control, time, parameters))


def _worst(
    constraint: PathConstraint, integrated: Rollout
) -> tuple[Float[Array, "conditions"], Int[Array, "conditions"]]:
    """Worst violation of each condition on a rollout, and its place; interval k has the parameters of node k."""
    count = integrated.time.shape[0]
    over_samples = jax.vmap(functools.partial(_violation, constraint), in_axes=(0, 0, 0, None))
    parameters = jax.tree.map(lambda p: p[:count], constraint.node_parameters())
    values = jax.vmap(over_samples)(integrated.state, integrated.control, integrated.time, parameters)
    values = jnp.where(_active(constraint, count)[..., None], values, 0.0).reshape(-1, values.shape[-1])
    return jnp.max(values, axis=0, initial=0.0), jnp.argmax(values, axis=0)


def _active(constraint: PathConstraint, count: int) -> Array:
    """Whether the constraint holds at each of so many nodes."""
    assert constraint.active is not None, "of a problem over scaled time"
    return constraint.active[:count, None]


def _worst_across(constraint: PathConstraint, trajectory: Trajectory) -> Float[Array, "conditions"]:
    """Worst violation of each condition on the controls at both ends of every interval."""
    intervals = trajectory.time.shape[0] - 1
    controls = jnp.concatenate([trajectory.control, trajectory.dilation[:, None]], axis=1)
    parameters = jax.tree.map(lambda p: p[:-1], constraint.node_parameters())
    function = constraint.with_parameters(constraint.function)

    def violation(first, last, parameters):
        return constraint.cone.violations(function(first, last, 1.0 / intervals, parameters))

    values = jax.vmap(violation)(controls[:-1], controls[1:], parameters)
    return jnp.max(jnp.where(_active(constraint, intervals), values, 0.0), axis=0, initial=0.0)


def _tolerance_there(
    constraint: PathConstraint, integrated: Rollout, place: Int[Array, "conditions"], sizes: Sizes
) -> Float[Array, "conditions"]:
    """Tolerance of each condition by the size of its values at the place of its worst violation.

    A size over the whole flight would let a path through a small disc: far away, the squared distance changes by more.
    """

    def size(condition, place):
        k, sample = place // integrated.time.shape[1], place % integrated.time.shape[1]
        x, u, time = integrated.state[k, sample], integrated.control[k, sample], integrated.time[k, sample]
        parameters = jax.tree.map(lambda p: p[k], constraint.node_parameters())

        def violation(x, u):
            return _violation(constraint, x, u, time, parameters)[condition]

        in_state, in_control = jax.grad(violation, argnums=(0, 1))(x, u)
        return jnp.abs(in_state) @ sizes.state + jnp.abs(in_control) @ sizes.control

    there = DISTANCE_TOLERANCE * jax.vmap(size)(jnp.arange(place.shape[0]), place)
    usual = jnp.broadcast_to(constraint.tolerance, there.shape)
    return jnp.where(jnp.isfinite(there), jnp.clip(there, LEAST_TOLERANCE * usual, usual), usual)


def _in_one_unit(
    at_nodes: Float[Array, "conditions"],
    between: Float[Array, "conditions"],
    tolerance: Float[Array, "*rows"],
) -> tuple[Scalar, Scalar, Scalar]:
    """Largest violations. Rows with tolerances of their own are compared by these, in the unit of the worst row."""
    if tolerance.ndim == 0:
        return jnp.max(at_nodes), jnp.max(between), tolerance
    allowed = tolerance[jnp.argmax(between / tolerance)]
    return jnp.max(at_nodes * (allowed / tolerance)), jnp.max(between * (allowed / tolerance)), allowed
