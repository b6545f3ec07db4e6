"""Clearance of the hull: a lower bound on its distance to the nearest obstacle point, over the whole path."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.core.obstacles import Hull
from jaxscp.core.types import Scalar
from jaxscp.verification.rollout import Rollout

PARTS = 50  # chords an interval, about


def clearance(hull: Hull, integrated: Rollout) -> Scalar:
    """Least distance in metres from the hull to an obstacle, or a little less; negative where one is in the hull.

    Between two of its points, the path lies within (h / 4) V of the chord. h is the time between the points, and V the
    length of the velocity's curve; h / 4 is the greatest value of the second derivative's Green function. So the
    distance to a chord, less that bound, holds between the samples. Obstacles beyond ``reach`` are not known.

    Args:
        hull: radius and obstacles, in the units of the rollout.
        integrated: rollout; position and velocity are its first six states.

    Returns:
        Metres; minus infinity if the integration failed.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.corridor import Hull, Obstacles
        >>> wall = jnp.array([[1.0, 1.0, 0.0]]), jnp.array([True]), jnp.array([False])
        >>> hull = Hull(jnp.array(0.25), Obstacles(*wall, jnp.array(0.0), jnp.array(5.0)), jnp.array([False]))
        >>> state = jnp.zeros((1, 3, 13)).at[0, :, 0].set([0.0, 0.8, 1.6]).at[0, :, 3].set(0.8)
        >>> float(clearance(hull, Rollout(jnp.array([[0.0, 1.0, 2.0]]), state, jnp.zeros((1, 3, 4)))))
        0.75
    """
    obstacles, samples = hull.obstacles, integrated.time.shape[1]
    stride = max(1, (samples - 1) // PARTS)
    chosen = jnp.asarray([*range(0, samples - 1, stride), samples - 1])
    position, time = integrated.state[:, chosen, :3], integrated.time[:, chosen]
    turning = jnp.linalg.norm(jnp.diff(integrated.state[:, :, 3:6], axis=1), axis=-1)
    length = jnp.pad(jnp.cumsum(turning, axis=1), ((0, 0), (1, 0)))[:, chosen]
    bound = 0.25 * jnp.diff(time, axis=1) * jnp.diff(length, axis=1)

    def nearest(interval):
        corners, bounds, at_deck = interval
        counts = obstacles.present & ~(obstacles.deck & at_deck)
        return jnp.min(_to_points(corners, obstacles.points, counts) - bounds)

    distance = jnp.min(jax.lax.map(nearest, (position, bound, hull.at_deck))) - obstacles.spread
    known = jnp.minimum(distance, obstacles.reach) - hull.radius
    return jnp.where(jnp.isnan(known), -jnp.inf, known)


def _to_points(
    corners: Float[Array, "corners 3"], points: Float[Array, "points 3"], counts: Bool[Array, "points"]
) -> Float[Array, "chords"]:
    """Distance of every chord of a polyline to the nearest point that counts; infinite without one."""
    chord = jnp.diff(corners, axis=0)
    square = jnp.sum(chord**2, axis=1)
    # axis by axis: XLA then fuses all of it into one reduction
    away = [points[None, :, k] - corners[:-1, k, None] for k in range(3)]
    along = sum(chord[:, k, None] * away[k] for k in range(3))
    fraction = jnp.clip(along / jnp.where(square > 0.0, square, 1.0)[:, None], 0.0, 1.0)
    squares = sum((away[k] - fraction * chord[:, k, None]) ** 2 for k in range(3))
    return jnp.sqrt(jnp.min(jnp.where(counts[None], squares, jnp.inf), axis=1))
