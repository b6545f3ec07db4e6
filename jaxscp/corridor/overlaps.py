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
    gain = jnp.array([0.0, 0.0, 0.0, 1.0], dtype)
    eps = jnp.finfo(dtype).eps

    # Start at the foot of the least-squares point of all faces, which is near the middle of small overlaps.
    gram = normals.T @ normals + eps * jnp.eye(3, dtype=dtype)
    middle = jnp.linalg.solve(gram, normals.T @ jnp.where(lengths > 0, offsets, 0.0))
    slack = offsets - normals @ middle
    deepest = jnp.min(jnp.where(lengths > 0, slack, jnp.inf))
    unknowns = jnp.append(middle, deepest - 1.0)
    slack = offsets - rows @ unknowns
    prices = 1.0 / slack

    def longest_step(value, move):
        return jnp.minimum(
            1.0, jnp.min(jnp.where(move < 0, -value / jnp.where(move < 0, move, 1.0), jnp.inf))
        )

    def step(_, state):
        unknowns, slack, prices = state
        primal = offsets - rows @ unknowns - slack
        dual = gain - rows.T @ prices
        mu = jnp.mean(slack * prices)
        weights = prices / slack
        normal = (rows.T * weights) @ rows
        factor = jnp.linalg.cholesky(normal + 16 * eps * jnp.trace(normal) * jnp.eye(4, dtype=dtype))

        def direction(product):
            # rows . dy + ds = primal;  rows^T dz = dual;  z ds + s dz = product
            right = rows.T @ (weights * primal - product / slack) + dual
            move = jax.scipy.linalg.cho_solve((factor, True), right)
            slack_move = primal - rows @ move
            return move, slack_move, (product - prices * slack_move) / slack

        _, ds, dz = direction(-slack * prices)
        ahead = jnp.mean((slack + longest_step(slack, ds) * ds) * (prices + longest_step(prices, dz) * dz))
        centring = (ahead / mu) ** 3
        move, ds, dz = direction(centring * mu - slack * prices - ds * dz)
        a, b = 0.99 * longest_step(slack, ds), 0.99 * longest_step(prices, dz)
        new = (unknowns + a * move, slack + a * ds, prices + b * dz)
        finite = jnp.all(jnp.isfinite(jnp.concatenate(new)))
        going = finite & (mu > eps) & (jnp.min(slack + a * ds) > 0)
        return tuple(jnp.where(going, after, before) for after, before in zip(new, state, strict=True))

    unknowns, _, _ = jax.lax.fori_loop(0, _STEPS, step, (unknowns, slack, prices))
    centre = unknowns[:3]
    gaps = jnp.where(
        lengths > 0, (offsets - normals @ centre) / jnp.where(lengths > 0, lengths, 1.0), jnp.inf
    )
    return Ball(centre, jnp.min(gaps))
