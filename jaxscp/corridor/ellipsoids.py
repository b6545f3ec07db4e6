"""Two ellipsoids that guide the growth of a polytope: around a segment, and inside a polytope.

Both are small enough to live in registers: the first is two reductions over the points, the second a few
Newton steps in nine unknowns.
"""

# pyright: reportArgumentType=false, reportOperatorIssue=false
# jax 0.9 declares of ``where`` that it may return a tuple, for arguments whose types are not declared

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, ScalarLike

from jaxscp.core.types import Vector3

Columns = Float[Array, "3 points"]
"""Points with the coordinate first, so that reductions run along memory."""


class Ellipsoid(eqx.Module):
    """The set {centre + shape u : |u| <= 1}."""

    shape: Float[Array, "3 3"]
    """Matrix that maps the unit ball to the ellipsoid about its centre, (3, 3), metres."""
    centre: Vector3
    """Centre, (3,), metres."""


def first_index_of_least(values: Float[Array, "points"]) -> tuple[Array, Array]:
    """Least value and its first index. Two plain reductions, faster on a CPU than one ``argmin``."""
    least = jnp.min(values)
    places = jnp.arange(values.size, dtype=jnp.int32)
    return least, jnp.min(jnp.where(values == least, places, values.size - 1))


def around_segment(points: Columns, active: Bool[Array, "points"], half: ScalarLike) -> Ellipsoid:
    """Ellipsoid about a segment that touches the nearest points and holds none.

    The segment lies on the x axis from ``-half`` to ``half`` and is the ellipsoid's first axis f. The second
    axis is the widest radius of revolution, ``b = min rho_i / sqrt(1 - (x_i / f)^2)``; rolled so that the
    point that sets it lies on y. The third is ``c = min |z_i| / sqrt(1 - (x_i / f)^2 - (y_i / b)^2)``.
    Neither exceeds f. This is the fixed point that the shrinking iteration of Liu et al. 2017 (RA-L, section
    III-A) reaches one point at a time.

    Args:
        points: (3, points) obstacle points in the segment's frame, metres.
        active: (points,) which of them count.
        half: half the segment's length f in metres; greater than zero.

    Example:
        >>> import jax.numpy as jnp
        >>> points = jnp.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.8]])
        >>> ellipsoid = around_segment(points, jnp.array([True, True]), 1.0)
        >>> [round(float(a), 6) for a in jnp.linalg.norm(ellipsoid.shape, axis=0)]
        [1.0, 0.5, 0.8]
    """
    x, y, z = points
    tiny = 64.0 * jnp.finfo(points.dtype).eps
    inside = 1.0 - (x / half) ** 2
    # Squares are compared: only the least needs a root.
    needed = (y * y + z * z) / jnp.maximum(inside, tiny)
    least, nearest = first_index_of_least(jnp.where(active & (inside > tiny), needed, jnp.inf))
    least = jnp.sqrt(least)
    b = jnp.clip(least, 1e-6 * half, half)
    roll = jnp.where(least < half, jnp.arctan2(z[nearest], y[nearest]), 0.0)
    cos, sin = jnp.cos(roll), jnp.sin(roll)

    y, z = cos * y + sin * z, cos * z - sin * y
    inside = inside - (y / b) ** 2
    needed = z * z / jnp.maximum(inside, tiny)
    # No point lies inside the surface of revolution, so c >= b: a lesser value is rounding of 0 / 0.
    c = jnp.clip(jnp.sqrt(jnp.min(jnp.where(active & (inside > tiny), needed, jnp.inf))), b, half)
    zero = jnp.zeros_like(b)
    shape = jnp.array([[half + zero, zero, zero], [zero, b * cos, -c * sin], [zero, b * sin, c * cos]])
    return Ellipsoid(shape, jnp.zeros(3, points.dtype))


_NEWTON_STEPS = 12
_WEIGHT_GROWTH = 2.2
_DIAGONAL = np.array([1, 0, 1, 0, 0, 1, 0, 0, 0])
_LINE_SEARCH = (1.0, 0.85, 0.7, 0.5, 0.35, 0.2, 0.1, 0.05, 0.02)


def inside_polytope(
    normals: Float[Array, "faces 3"], offsets: Float[Array, "faces"], start: Vector3
) -> tuple[Ellipsoid, Float[Array, ""]]:
    """Ellipsoid of nearly the largest volume inside a polytope, and the logarithm of volume over a ball's.

    Maximises ``log det L`` over lower triangular L and centre d with ``|L^T a_i| <= b_i - a_i . d`` (the
    second-order cone form of Wang et al. 2024, FIRI, section V) by Newton's method on the logarithmic
    barrier, whose weight grows at every step. The shape returned is L, always strictly inside.

    Args:
        normals: (faces, 3) unit normals a, or zero rows.
        offsets: (faces,) offsets b in metres; positive in zero rows.
        start: a point strictly inside, metres.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> room = jaxscp.corridor.box([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0])
        >>> ellipsoid, _ = inside_polytope(room.normals, room.offsets, jnp.zeros(3))
        >>> bool(jnp.allclose(ellipsoid.shape, jnp.diag(jnp.array([1.0, 2.0, 3.0])), atol=0.02))
        True
    """
    slack = offsets - normals @ start
    linear, signs = _cone_rows(normals)
    # Half the second derivative of every face's depth: constant, for the depth is quadratic.
    curvature = jnp.einsum("r,rif,rjf->ijf", signs, linear, linear)
    unknowns = jnp.concatenate(
        [0.5 * jnp.min(slack) * jnp.asarray(_DIAGONAL[:6], normals.dtype), jnp.zeros(3, normals.dtype)]
    )

    def newton(step, state):
        return _newton_step(step, state, linear, signs, curvature)

    w = jnp.einsum("rif,i->rf", linear, unknowns).at[0].add(slack)
    u, _ = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, (unknowns, w))
    zero = jnp.zeros_like(u[0])
    shape = jnp.array([[u[0], zero, zero], [u[1], u[2], zero], [u[3], u[4], u[5]]])
    return Ellipsoid(shape, start + u[6:]), jnp.log(u[0]) + jnp.log(u[2]) + jnp.log(u[5])


def _cone_rows(normals: Float[Array, "faces 3"]) -> tuple[Float[Array, "4 9 faces"], Float[Array, "4"]]:
    """Rows of the cone vector (t, v) = (b - a . d, L^T a) per face, and the signs of their squares.

    They are linear in (l00, l10, l11, l20, l21, l22, d). Faces come last, so that every pass runs along memory.
    """
    a0, a1, a2 = normals.T
    o = jnp.zeros_like(a0)
    linear = jnp.stack(
        [
            jnp.stack([o, o, o, o, o, o, -a0, -a1, -a2]),
            jnp.stack([a0, a1, o, a2, o, o, o, o, o]),
            jnp.stack([o, o, a1, o, a2, o, o, o, o]),
            jnp.stack([o, o, o, o, o, a2, o, o, o]),
        ]
    )
    return linear, jnp.array([1.0, -1.0, -1.0, -1.0], normals.dtype)


def _depth(w: Array) -> Array:
    """Product (t - |v|) (t + |v|) of every face, zero outside its cone."""
    side = jnp.sqrt(w[..., 1, :] ** 2 + w[..., 2, :] ** 2 + w[..., 3, :] ** 2)
    return jnp.where(w[..., 0, :] > side, (w[..., 0, :] - side) * (w[..., 0, :] + side), 0.0)


def _merit(unknowns: Array, depths: Array, weight: Array) -> Array:
    """Barrier function; infinite outside its domain."""
    lengths = jnp.where(_DIAGONAL > 0, unknowns, 1.0)
    value = -weight * jnp.sum(jnp.log(lengths), axis=-1) - jnp.sum(jnp.log(depths), axis=-1)
    return jnp.where(jnp.all(lengths > 0, axis=-1) & jnp.isfinite(value), value, jnp.inf)


def _newton_step(step, state, linear, signs, curvature):
    """One step of Newton's method on the barrier, with the best of a few lengths."""
    unknowns, w = state
    steps = jnp.asarray(_LINE_SEARCH, w.dtype)
    weight = jnp.asarray(_WEIGHT_GROWTH, w.dtype) ** step
    d = _depth(w)
    along = jnp.sum(linear * (signs[:, None] * w / d)[:, None], axis=0)
    inverse = jnp.where(_DIAGONAL > 0, 1.0 / unknowns, 0.0)
    gradient = -2.0 * jnp.sum(along, axis=1) - weight * inverse
    hessian = 4.0 * along @ along.T - 2.0 * curvature @ (1.0 / d) + jnp.diag(weight * inverse**2)
    move = -jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(hessian), True), gradient)
    w_move = jnp.einsum("rif,i->rf", linear, move)
    trials = unknowns + steps[:, None] * move
    values = _merit(trials, _depth(w + steps[:, None, None] * w_move), weight)
    best = jnp.argmin(values)
    taken = jnp.where(values[best] < _merit(unknowns, d, weight), steps[best], 0.0)
    # A step that is not taken may not be finite.
    return jax.tree.map(lambda a, da: jnp.where(taken > 0, a + taken * da, a), (unknowns, w), (move, w_move))
