"""Second-order cones {(t, v): |v| <= t}, along the last axis: products, distance to the boundary, scaling.

Formulas: Vandenberghe, "The CVXOPT linear and quadratic cone program solvers" (2010), sections 4 and 5.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

_TINY = 1e-300  # keeps divisions finite in cones that are only padding


def reflect(v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """J v = (t, -v)."""
    return jnp.concatenate([v[..., :1], -v[..., 1:]], axis=-1)


def determinant(v: Float[Array, "*b d"]) -> Float[Array, "*b"]:
    """t^2 - |v|^2, as a product because the difference of squares cancels near the boundary."""
    norm = jnp.linalg.norm(v[..., 1:], axis=-1)
    return (v[..., 0] - norm) * (v[..., 0] + norm)


def jordan_product(a: Float[Array, "*b d"], b: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """a o b = (a'b, a_0 b_1 + b_0 a_1)."""
    head = jnp.sum(a * b, axis=-1, keepdims=True)
    return jnp.concatenate([head, a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:]], axis=-1)


def jordan_divide(a: Float[Array, "*b d"], b: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """The u with a o u = b, for a inside the cone."""
    head = (jnp.sum(reflect(a) * b, axis=-1) / jnp.maximum(determinant(a), _TINY))[..., None]
    return jnp.concatenate([head, (b[..., 1:] - head * a[..., 1:]) / a[..., :1]], axis=-1)


def step_to_boundary(point: Float[Array, "*b d"], direction: Float[Array, "*b d"]) -> Float[Array, "*b"]:
    """Largest step that stays in the cone (infinite where every step does)."""
    root = jnp.sqrt(jnp.maximum(determinant(point), _TINY))[..., None]
    p, d = point / root, direction / root
    head = jnp.sum(reflect(p) * d, axis=-1)
    tail = d[..., 1:] - ((head + d[..., 0]) / (p[..., 0] + 1.0))[..., None] * p[..., 1:]
    return 1.0 / jnp.maximum(jnp.linalg.norm(tail, axis=-1) - head, _TINY)


class SecondOrderScaling(eqx.Module):
    """Nesterov-Todd scaling W = eta Wbar of a group of second-order cones; W^2 = eta^2 (2 w w' - J)."""

    eta: Float[Array, "*b"]
    w: Float[Array, "*b d"]

    def apply(self, v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """W v."""
        return self.eta[..., None] * _hyperbolic(self.w, v)

    def apply_inverse(self, v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """W^-1 v."""
        return _hyperbolic(reflect(self.w), v) / self.eta[..., None]

    def square(self, v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """W^2 v."""
        projection = jnp.sum(self.w * v, axis=-1, keepdims=True)
        return self.eta[..., None] ** 2 * (2.0 * self.w * projection - reflect(v))

    def inverse_square(self, v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
        """W^-2 v."""
        mirrored = reflect(self.w)
        projection = jnp.sum(mirrored * v, axis=-1, keepdims=True)
        return (2.0 * mirrored * projection - reflect(v)) / self.eta[..., None] ** 2

    def inverse_square_parts(self) -> tuple[Float[Array, "*b d"], Float[Array, "*b d"]]:
        """W^-2 as a diagonal, and a vector whose outer square is added."""
        size = self.eta[..., None]
        return -reflect(jnp.ones_like(self.w)) / size**2, jnp.sqrt(2.0) * reflect(self.w) / size


def _hyperbolic(w: Float[Array, "*b d"], v: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """[w0 w1'; w1 I + w1 w1' / (1 + w0)] v."""
    head = jnp.sum(w * v, axis=-1, keepdims=True)
    along = jnp.sum(w[..., 1:] * v[..., 1:], axis=-1, keepdims=True)
    return jnp.concatenate(
        [head, v[..., 1:] + w[..., 1:] * (v[..., :1] + along / (1.0 + w[..., :1]))], axis=-1
    )


def second_order_scaling(s: Float[Array, "*b d"], y: Float[Array, "*b d"]) -> SecondOrderScaling:
    """The scaling point of a primal and a dual interior point: W y = W^-1 s."""
    det_s, det_y = jnp.maximum(determinant(s), _TINY), jnp.maximum(determinant(y), _TINY)
    s_bar, y_bar = s / jnp.sqrt(det_s)[..., None], y / jnp.sqrt(det_y)[..., None]
    gamma = jnp.sqrt(0.5 * (1.0 + jnp.sum(s_bar * y_bar, axis=-1)))[..., None]
    return SecondOrderScaling((det_s / det_y) ** 0.25, (s_bar + reflect(y_bar)) / (2.0 * gamma))
