"""The widest ball inside a polytope, and so the depth of an overlap between two."""

# pyright: reportArgumentType=false, reportOperatorIssue=false
# jax 0.9 declares of ``where`` that it may return a tuple, for arguments whose types are not declared

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Vector3
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytope import intersect as intersect

_STEPS = 24


class Ball(eqx.Module):
    """A ball; its radius is negative where the set that should hold it is empty."""

    centre: Vector3
    """Centre, (3,), metres."""
    radius: Float[Array, ""]
    """Radius in metres, true for the centre given: the distance to the nearest face."""


@jax.jit
def deepest_ball(polytope: Polytope) -> Ball:
    """Widest ball inside a bounded polytope (its Chebyshev centre).

    The linear program ``max r`` subject to ``a_i . x + |a_i| r <= b_i``, in four unknowns, by Mehrotra's
    predictor-corrector method with a fixed number of steps: it always starts strictly feasible, for a ball of
    large enough negative radius is inside anything. Where several balls are equally wide, the centre is
    central among theirs.

    Example:
        >>> import jaxscp
        >>> ball = deepest_ball(jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 2.0, 3.0]))
        >>> round(float(ball.radius), 4)
        1.0
    """
    normals, offsets = polytope.normals, polytope.offsets
    dtype = normals.dtype
    lengths = jnp.sqrt(jnp.sum(normals * normals, axis=1))
    rows = jnp.concatenate([normals, lengths[:, None]], axis=1)
    eps = jnp.finfo(dtype).eps

    # Start at the foot of the least-squares point of all faces, which is near the middle of small overlaps.
    gram = normals.T @ normals + eps * jnp.eye(3, dtype=dtype)
    middle = jnp.linalg.solve(gram, normals.T @ jnp.where(lengths > 0, offsets, 0.0))
    slack = offsets - normals @ middle
    deepest = jnp.min(jnp.where(lengths > 0, slack, jnp.inf))
    unknowns = jnp.append(middle, deepest - 1.0)
    slack = offsets - rows @ unknowns
    multipliers = 1.0 / slack

    def step(_, state):
        return _predictor_corrector(state, rows, offsets)

    unknowns, _, _ = jax.lax.fori_loop(0, _STEPS, step, (unknowns, slack, multipliers))
    centre = unknowns[:3]
    gaps = jnp.where(
        lengths > 0, (offsets - normals @ centre) / jnp.where(lengths > 0, lengths, 1.0), jnp.inf
    )
    return Ball(centre, jnp.min(gaps))


def overlap_balls(before: Polytope, after: Polytope) -> Ball:
    """Widest ball in the overlap of each pair of polytopes; batched along axis 0.

    Example:
        >>> import jax, jaxscp
        >>> box = jaxscp.corridor.box
        >>> pair = box([0.0, 0, 0], [4.0, 2, 3]), box([3.0, 0, 0], [9.0, 2, 3])
        >>> overlap_balls(*[jax.tree.map(lambda rows: rows[None], each) for each in pair]).radius.round(4).tolist()
        [0.5]
    """
    return jax.vmap(lambda a, b: deepest_ball(intersect(a, b)))(before, after)


def _longest_step(value: Array, move: Array) -> Array:
    """Largest step, at most one, that leaves every value positive."""
    return jnp.minimum(1.0, jnp.min(jnp.where(move < 0, -value / jnp.where(move < 0, move, 1.0), jnp.inf)))


def _predictor_corrector(state: tuple[Array, Array, Array], rows: Array, offsets: Array):
    """One step of Mehrotra's method; the state stays as it is where that is not finite."""
    unknowns, slack, multipliers = state
    dtype = rows.dtype
    gain, eps = jnp.array([0.0, 0.0, 0.0, 1.0], dtype), jnp.finfo(dtype).eps
    primal = offsets - rows @ unknowns - slack
    dual = gain - rows.T @ multipliers
    mu = jnp.mean(slack * multipliers)
    weights = multipliers / slack
    normal = (rows.T * weights) @ rows
    factor = jnp.linalg.cholesky(normal + 16 * eps * jnp.trace(normal) * jnp.eye(4, dtype=dtype))

    def direction(product):
        # rows . dy + ds = primal;  rows^T dz = dual;  z ds + s dz = product
        right = rows.T @ (weights * primal - product / slack) + dual
        move = jax.scipy.linalg.cho_solve((factor, True), right)
        slack_move = primal - rows @ move
        return move, slack_move, (product - multipliers * slack_move) / slack

    _, ds, dz = direction(-slack * multipliers)
    predicted = jnp.mean(
        (slack + _longest_step(slack, ds) * ds) * (multipliers + _longest_step(multipliers, dz) * dz)
    )
    centring = (predicted / mu) ** 3
    move, ds, dz = direction(centring * mu - slack * multipliers - ds * dz)
    a, b = 0.99 * _longest_step(slack, ds), 0.99 * _longest_step(multipliers, dz)
    new = (unknowns + a * move, slack + a * ds, multipliers + b * dz)
    finite = jnp.all(jnp.isfinite(jnp.concatenate(new)))
    going = finite & (mu > eps) & (jnp.min(slack + a * ds) > 0)
    return tuple(jnp.where(going, after, before) for after, before in zip(new, state, strict=True))
