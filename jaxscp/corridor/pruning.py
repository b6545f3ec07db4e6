"""Polytopes left out of a chain: those without which the way stays about as wide, and rows that are no faces."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscp.corridor.overlaps import overlap_balls
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.shapes import needed_faces

Segments = Float[np.ndarray, "segments 2 3"]

_PAIRS_A_CALL = 16
"""Overlaps measured at once: one number, so that one shape is compiled."""


_overlap_balls = jax.jit(overlap_balls)


def _balls(polytopes: Polytope, pairs: list[tuple[int, int]]) -> Float[np.ndarray, "pairs 4"]:
    """Centre and radius of the widest ball in the overlaps of some pairs of polytopes."""
    found = [np.empty((0, 4))]
    for first in range(0, len(pairs), _PAIRS_A_CALL):
        some = pairs[first : first + _PAIRS_A_CALL]
        sides = np.resize(np.array(some), (_PAIRS_A_CALL, 2)).T
        ball = jax.device_get(_overlap_balls(*[chosen(polytopes, side.tolist()) for side in sides]))
        found.append(np.concatenate([ball.centre, ball.radius[:, None]], axis=1)[: len(some)])
    return np.concatenate(found).astype(float)


def without_redundant(
    polytopes: Polytope, clearance: float
) -> tuple[list[int], Float[np.ndarray, "joints 4"]]:
    """Which polytopes to keep, and the overlaps between those."""
    rows = list(range(len(polytopes.offsets)))
    while True:
        neighbours = list(pairwise(rows))
        seconds = list(zip(rows[:-2], rows[2:], strict=True))
        balls = _balls(polytopes, neighbours + seconds)
        near, far = balls[: len(neighbours)], balls[len(neighbours) :]
        dropped = _droppable(near[:, 3], far[:, 3], clearance)
        if not dropped:
            return rows, near
        rows = [rows[place] for place in range(len(rows)) if place not in dropped]


def chosen(polytopes: Polytope, rows: list[int]) -> Polytope:
    """Polytopes of the given numbers."""
    return jax.tree.map(lambda array: array[np.array(rows)], polytopes)


def _droppable(
    near: Float[np.ndarray, "joints"], far: Float[np.ndarray, "seconds"], clearance: float
) -> set[int]:
    """Polytopes, no two of them neighbours, without which the way stays at least half as wide."""
    dropped: set[int] = set()
    for middle in range(1, len(far) + 1):
        enough = max(clearance, 0.5 * min(near[middle - 1], near[middle]))
        if middle - 1 not in dropped and far[middle - 1] >= enough:
            dropped.add(middle)
    return dropped


def packed(polytopes: Polytope, seeds: Segments, joints: Float[np.ndarray, "joints 3"]) -> Corridor:
    """Rows that are not faces left out, the rest moved to the front."""
    cells = [
        Polytope(jnp.asarray(n), jnp.asarray(b))
        for n, b in zip(polytopes.normals, polytopes.offsets, strict=True)
    ]
    needed = [needed_faces(cell, seed.mean(axis=0)) for cell, seed in zip(cells, seeds, strict=True)]
    most = max(len(rows) for rows in needed)
    normals = np.zeros((len(cells), most, 3))
    offsets = np.ones((len(cells), most))
    for k, (cell, rows) in enumerate(zip(cells, needed, strict=True)):
        normals[k, : len(rows)] = np.asarray(cell.normals)[rows]
        offsets[k, : len(rows)] = np.asarray(cell.offsets)[rows]
    return Corridor(jnp.asarray(normals), jnp.asarray(offsets), jnp.asarray(joints))
