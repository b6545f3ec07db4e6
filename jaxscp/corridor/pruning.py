"""Polytopes left out of a chain: those without which the way stays about as wide, and rows that are no faces."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscp.corridor.cells import consecutive_overlaps
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.polytopes import Corridor
from jaxscp.corridor.shapes import needed_faces

Segments = Float[np.ndarray, "segments 2 3"]

_overlaps = jax.jit(consecutive_overlaps, static_argnames="skip")


def _balls(polytopes: Polytope, skip: int) -> Float[np.ndarray, "pairs 4"]:
    """Centre and radius of the widest ball in each overlap; rows padded so that few shapes are compiled."""
    count = len(polytopes.offsets)
    if count <= skip:
        return np.empty((0, 4))
    padded = jax.tree.map(
        lambda rows: np.concatenate([rows, np.repeat(rows[-1:], -count % 8, axis=0)]), polytopes
    )
    ball = _overlaps(jax.tree.map(jnp.asarray, padded), skip=skip)
    found = np.concatenate([np.asarray(ball.centre), np.asarray(ball.radius)[:, None]], axis=1)
    return found[: count - skip].astype(float)


def without_redundant(
    polytopes: Polytope, clearance: float
) -> tuple[list[int], Float[np.ndarray, "joints 4"]]:
    """Which polytopes to keep, and the overlaps between those."""
    kept = list(range(len(polytopes.offsets)))
    while True:
        left = chosen(polytopes, kept)
        near, far = _balls(left, 1), _balls(left, 2)
        dropped = _droppable(near[:, 3], far[:, 3], clearance)
        if not dropped:
            return kept, near
        kept = [kept[place] for place in range(len(kept)) if place not in dropped]


def chosen(polytopes: Polytope, kept: list[int]) -> Polytope:
    """Polytopes of the given numbers."""
    return jax.tree.map(lambda rows: rows[np.array(kept)], polytopes)


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
