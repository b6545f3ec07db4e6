"""Attitudes, body rates and thrusts along a path.

A vehicle with thrust along one body axis is differentially flat in position and heading (Mellinger and Kumar, "Minimum
snap trajectory generation and control for quadrotors", 2011).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Controls, Quaternion, Scalar, Vector3
from jaxscp.dynamics import rotations
from jaxscp.dynamics.rigid_body import RigidBody

LEAST_LIFT = 0.3  # least upward thrust, in weights: a dive needs no somersault
OPPOSITE = 1e-3  # of one plus the cosine: below it the axis of the turn is undetermined


def attitudes(
    body: RigidBody, acceleration: Float[Array, "nodes 3"], heading: Float[Array, "nodes 4"]
) -> Float[Array, "nodes 4"]:
    """Attitudes with the z axis along the thrust of a path's acceleration, at the given headings.

    Args:
        body: of the vehicle.
        acceleration: of the path, m/s^2 in the world.
        heading: attitudes to turn from by the shortest rotation, unit quaternions.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> from jaxscp.dynamics import flatness, rotations
        >>> body = jaxscp.airframes.paper_mav().body
        >>> level = rotations.from_yaw(0.0)[None]
        >>> tilted = flatness.attitudes(body, jnp.array([[9.81, 0.0, 0.0]]), level)[0]
        >>> round(float(jnp.rad2deg(rotations.tilt(tilted))), 3)
        45.0
    """
    return jax.vmap(_along)(jax.vmap(_specific_force, (None, 0))(body, acceleration), heading)


def body_rates(attitude: Float[Array, "nodes 4"], interval: Scalar) -> Float[Array, "nodes 3"]:
    """Body rates in rad/s, by differences of attitudes an interval (in s) from each other."""
    rate = _rate(attitude, interval)
    return 2.0 * jax.vmap(lambda q, dq: rotations.multiply(rotations.conjugate(q), dq)[1:])(attitude, rate)


def thrusts(
    body: RigidBody,
    acceleration: Float[Array, "nodes 3"],
    body_rate: Float[Array, "nodes 3"],
    interval: Scalar,
) -> Controls:
    """Least-norm thrusts in N for an acceleration and body rates: equations (2) and (4), solved for the thrusts."""
    force = body.mass * jnp.linalg.norm(jax.vmap(_specific_force, (None, 0))(body, acceleration), axis=1)
    spin = body_rate @ body.inertia.T
    torque = _rate(spin, interval) + jnp.cross(body_rate, spin)
    wrench = jnp.concatenate([jnp.zeros((*force.shape, 2)), force[:, None], torque], axis=1)
    return wrench @ body.least_thrusts().T


def _rate(values: Float[Array, "nodes numbers"], interval: Scalar) -> Float[Array, "nodes numbers"]:
    """Central differences, one-sided at the ends."""
    change: Array = jnp.asarray(jnp.gradient(values, axis=0))
    return change / interval


def _specific_force(body: RigidBody, acceleration: Vector3) -> Vector3:
    """Thrust over mass in the world, with at least ``LEAST_LIFT`` upwards, so that the body stays upright."""
    force, weight = acceleration - body.gravity, jnp.linalg.norm(body.gravity)
    up = -body.gravity / jnp.maximum(weight, 1e-9)
    return force + up * jnp.maximum(0.0, LEAST_LIFT * weight - force @ up)


def _along(force: Vector3, attitude: Quaternion) -> Quaternion:
    """The attitude, rotated until its z axis is along a force."""
    size = jnp.linalg.norm(force)
    axis = rotations.rotation_matrix(attitude)[:, 2]
    towards = jnp.where(size > 0, force / jnp.maximum(size, 1e-30), axis)
    # the half angle's cosine and sine times one length: 1 + cos, and the sine
    head = jnp.maximum(1.0 + axis @ towards, OPPOSITE)
    turn = jnp.concatenate([head[None], jnp.cross(axis, towards)])
    return rotations.multiply(turn / jnp.linalg.norm(turn), attitude)
