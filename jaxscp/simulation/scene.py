"""Obstacles as boxes and cylinders: drawn from a seed, distances to them, rays against them."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxscp.core.types import Scalar, Vector3

_FAR = 1e9


class Scene(eqx.Module):
    """Boxes along the axes, upright cylinders, and the ground at z = 0.

    Example:
        >>> import jax.numpy as jnp
        >>> scene = Scene(centres=jnp.array([[3.0, 0.0, 1.0]]), halves=jnp.array([[0.5, 2.0, 1.0]]),
        ...               axes=jnp.array([[0.0, 4.0]]), radii=jnp.array([0.3]), heights=jnp.array([3.0]))
        >>> float(scene.distance(jnp.array([1.5, 0.0, 1.5])))
        1.0
        >>> float(scene.range(jnp.array([0.0, 0.0, 1.5]), jnp.array([1.0, 0.0, 0.0])))
        2.5
    """

    centres: Float[Array, "boxes 3"]
    """Centres of the boxes, m."""
    halves: Float[Array, "boxes 3"]
    """Half of the boxes' sizes, m."""
    axes: Float[Array, "cylinders 2"]
    """Axes of the cylinders, x and y, m."""
    radii: Float[Array, "cylinders"]
    """m."""
    heights: Float[Array, "cylinders"]
    """Cylinders reach from the ground to this height, m."""

    def distance(self, point: Vector3) -> Scalar:
        """Distance in m to the nearest surface, negative inside an obstacle; the ground counts."""
        out = jnp.abs(point - self.centres) - self.halves
        boxes = _outside(out)
        radial = jnp.linalg.norm(point[:2] - self.axes, axis=-1) - self.radii
        cylinders = _outside(jnp.stack([radial, point[2] - self.heights], axis=-1))
        return jnp.minimum(jnp.min(jnp.concatenate([boxes, cylinders])), point[2])

    def range(self, origin: Vector3, direction: Vector3) -> Scalar:
        """Distance in m along a unit direction to the first surface, infinite without one. From outside obstacles."""
        return self.ranges(origin, direction[None])[0]

    def ranges(self, origin: Vector3, directions: Float[Array, "rays 3"]) -> Float[Array, "rays"]:
        """The same along many directions, obstacle by obstacle: all rays at once are one vector operation."""
        ways = jnp.where(jnp.abs(directions) < 1e-12, 1e-12, directions).T
        ground = jnp.where(ways[2] < 0.0, -origin[2] / ways[2], jnp.inf)

        def box(nearest: Array, sides: tuple[Array, Array]):
            return jnp.minimum(nearest, _box(sides, origin, ways)), None

        def cylinder(nearest: Array, parts: tuple[Array, Array, Array]):
            return jnp.minimum(nearest, _cylinder(parts, origin, ways)), None

        boxes = self.centres - self.halves, self.centres + self.halves
        nearest, _ = jax.lax.scan(box, ground, boxes)
        return jax.lax.scan(cylinder, nearest, (self.axes, self.radii, self.heights))[0]


def _box(sides: tuple[Array, Array], origin: Vector3, ways: Float[Array, "3 rays"]) -> Float[Array, "rays"]:
    """Distances along rays to a box, infinite where it is missed."""
    near, far = _slab(sides[0][:, None], sides[1][:, None], origin[:, None], ways)
    enter, leave = jnp.max(near, axis=0), jnp.min(far, axis=0)
    return jnp.where((enter <= leave) & (enter >= 0.0), enter, jnp.inf)


def _cylinder(
    parts: tuple[Array, Array, Array], origin: Vector3, ways: Float[Array, "3 rays"]
) -> Float[Array, "rays"]:
    """The same of an upright cylinder: axis, radius, height."""
    axis, radius, height = parts
    offset = origin[:2] - axis
    a, b = ways[0] ** 2 + ways[1] ** 2, offset[0] * ways[0] + offset[1] * ways[1]
    root = b**2 - a * (jnp.sum(offset**2) - radius**2)
    half = jnp.sqrt(jnp.maximum(root, 0.0))
    low, high = _slab(-_FAR, height, origin[2], ways[2])
    enter, leave = jnp.maximum((-b - half) / a, low), jnp.minimum((-b + half) / a, high)
    return jnp.where((root > 0.0) & (enter <= leave) & (enter >= 0.0), enter, jnp.inf)


def _outside(out: Float[Array, "obstacles parts"]) -> Float[Array, "obstacles"]:
    """Signed distance of a product of intervals from the signed distances of its factors."""
    positive = jnp.sqrt(jnp.sum(jnp.maximum(out, 0.0) ** 2, axis=-1))
    return positive + jnp.minimum(jnp.max(out, axis=-1), 0.0)


def _slab(low, high, origin, direction) -> tuple[Array, Array]:
    """Distances at which rays enter and leave slabs."""
    first, second = (low - origin) / direction, (high - origin) / direction
    return jnp.minimum(first, second), jnp.maximum(first, second)


def indoor(key: PRNGKeyArray, boxes: int = 6, cylinders: int = 6) -> Scene:
    """A hall of 10 x 20 x 6 m with obstacles; the ends y < 4 m and y > 16 m stay free."""
    return _draw(key, (10.0, 20.0), (boxes, cylinders), 6.0)


def outdoor(key: PRNGKeyArray, boxes: int = 10, cylinders: int = 40) -> Scene:
    """A field of 50 x 50 m with trunks and boxes; the ends y < 4 m and y > 46 m stay free."""
    return _draw(key, (50.0, 50.0), (boxes, cylinders), 8.0)


def _draw(key: PRNGKeyArray, size: tuple[float, float], counts: tuple[int, int], top: float) -> Scene:
    """Obstacles that stand on the ground, at uniform places."""
    keys = jax.random.split(key, 5)
    low, high = jnp.array([0.5, 4.0]), jnp.array([size[0] - 0.5, size[1] - 4.0])
    halves = jax.random.uniform(keys[0], (counts[0], 3), minval=0.2, maxval=jnp.array([0.8, 0.5, top / 3.0]))
    places = jax.random.uniform(keys[1], (counts[0], 2), minval=low, maxval=high)
    return Scene(
        jnp.concatenate([places, halves[:, 2:]], axis=-1),
        halves,
        jax.random.uniform(keys[2], (counts[1], 2), minval=low, maxval=high),
        jax.random.uniform(keys[3], (counts[1],), minval=0.1, maxval=0.3),
        jax.random.uniform(keys[4], (counts[1],), minval=0.3 * top, maxval=top),
    )
