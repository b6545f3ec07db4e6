"""Unit quaternions (w, x, y, z) that rotate body vectors into the world."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import namespace
from jaxscp.core.types import Quaternion, Scalar, Vector3

# A product with a table of signs takes a tenth of the operations, to trace and to compile, of a formula of components.
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3))
"""(a x b)[k] is the sum of _CROSS[k, i, j] a[i] b[j]."""

_PRODUCT = np.zeros((4, 4, 4))
"""The same for the Hamilton product."""
_PRODUCT[0] = np.diag([1.0, -1.0, -1.0, -1.0])
_PRODUCT[1:, 0, 1:] = _PRODUCT[1:, 1:, 0] = np.eye(3)
_PRODUCT[1:, 1:, 1:] = _CROSS

_ROTATION = np.zeros((3, 3, 4, 4))
"""The same for w V + V V, where V is the cross product with (x, y, z): half of R(q) - I by Rodrigues' formula."""
_ROTATION[:, :, 0, 1:] = -_CROSS
_ROTATION[:, :, 1:, 1:] = np.einsum("rmi,mcj->rcij", _CROSS, _CROSS)


def _bilinear(signs: np.ndarray, a: Quaternion, b: Quaternion) -> Array:
    """Sums of signs[..., i, j] a[i] b[j] over i and j."""
    products = a[:, None] * b
    return jnp.sum(jnp.asarray(signs, products.dtype) * products, axis=(-2, -1))


def rotation_matrix(q: Quaternion) -> Float[Array, "3 3"]:
    """R(q): columns are the body axes in world coordinates.

    A polynomial, so that linearisation needs no division; a rotation for unit quaternions only. Linearised steps let
    the norm drift to second order. In this form such a drift does not change a level vehicle's thrust.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.dynamics.rotations import rotation_matrix
        >>> bool((rotation_matrix(jnp.array([1.0, 0.0, 0.0, 0.0])) == jnp.eye(3)).all())
        True
    """
    return jnp.eye(3, dtype=q.dtype) + 2.0 * _bilinear(_ROTATION, q, q)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: rotate by b, then by a."""
    return _bilinear(_PRODUCT, a, b)


def conjugate(q: Quaternion) -> Quaternion:
    """The inverse rotation of a unit quaternion."""
    return jnp.concatenate([q[:1], -q[1:]])


def quaternion_rate(q: Quaternion, body_rate: Vector3) -> Quaternion:
    """1/2 Omega(w) q of equation (3): derivative of the attitude at a body rate in rad/s."""
    return 0.5 * multiply(q, jnp.concatenate([jnp.zeros_like(body_rate[:1]), body_rate]))


def attitude_error(q: Quaternion, target: Quaternion) -> Vector3:
    """Vector part of the rotation from target to q: half the rotation vector in radians, to first order.

    Three numbers, not four: the dynamics keep |q|, so that a fourth constraint would be degenerate. Of the two
    quaternions of one attitude, the nearer one gives the sign.
    """
    error = multiply(conjugate(target), q)
    return jnp.where(error[0] < 0, -error[1:], error[1:])


def angle_between(a: Quaternion, b: Quaternion) -> Scalar:
    """Angle in radians of the rotation that takes attitude a to attitude b."""
    error = multiply(conjugate(a), b)
    return 2.0 * jnp.arctan2(jnp.linalg.norm(error[1:]), jnp.abs(error[0]))


def tilt(q: Quaternion) -> Scalar:
    """Angle in radians between the body's z axis and the vertical."""
    return jnp.arccos(jnp.clip(rotation_matrix(q)[2, 2], -1.0, 1.0))


def from_yaw(yaw: Scalar | float) -> Quaternion:
    """Level attitude at a heading in radians, counter-clockwise from the world's x axis.

    Example:
        >>> from jaxscp.dynamics.rotations import from_yaw
        >>> from_yaw(0.0).tolist()
        [1.0, 0.0, 0.0, 0.0]
    """
    xp = namespace(yaw)
    half = 0.5 * xp.asarray(yaw, float)
    zero = xp.zeros_like(half)
    return jnp.asarray(xp.stack([xp.cos(half), zero, zero, xp.sin(half)]))


def normalised(q: Quaternion) -> Quaternion:
    """The quaternion at unit length."""
    return q / jnp.maximum(jnp.linalg.norm(q), 1e-9)


def blend(start: Quaternion, goal: Quaternion, count: int) -> Float[Array, "count 4"]:
    """Normalised linear interpolation along the shorter arc, from start to goal."""
    goal = jnp.where(jnp.dot(start, goal) < 0, -goal, goal)
    fraction = jnp.linspace(0.0, 1.0, count)[:, None]
    return jax.vmap(normalised)((1.0 - fraction) * start + fraction * goal)
