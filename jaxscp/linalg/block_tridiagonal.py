"""Cholesky factorisation of a symmetric positive definite block tridiagonal matrix, by cyclic reduction.

Each round eliminates every second block and leaves a chain of half the length: n blocks take log2 n batched rounds in
place of n small steps. The order is a nested dissection (George, "Nested dissection of a regular finite element mesh",
1973). The method is as stable as any Cholesky factorisation.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.linalg.batched import gram, inverse_factor, times, times_transposed, transpose_times


class Round(eqx.Module):
    """Factor of one round: the odd blocks D_j = L_j L_j', and their coupling S to even neighbours."""

    inverse: Float[Array, "odd size size"]
    """L_j^-1."""
    left: Float[Array, "odd size size"]
    """L_j^-1 S_{j,j-1}."""
    right: Float[Array, "odd size size"]
    """L_j^-1 S_{j,j+1}; zero for the last block."""


class BlockCholesky(eqx.Module):
    """Cholesky factor of S, round by round."""

    rounds: tuple[Round, ...]
    last: Float[Array, "1 size size"]
    """L^-1 of the remaining block."""


def factor(
    diagonal: Float[Array, "blocks size size"], above: Float[Array, "blocks size size"]
) -> BlockCholesky:
    """Factor of S.

    Args:
        diagonal: diagonal blocks.
        above: blocks right of the diagonal ones; the last is zero.
    """
    rounds = []
    while (blocks := diagonal.shape[0]) > 1:
        even, odd = blocks - blocks // 2, blocks // 2
        inverse = inverse_factor(diagonal[1::2])
        left = times_transposed(inverse, above[::2][:odd])
        right = inverse @ above[1::2]
        rounds.append(Round(inverse, left, right))
        diagonal = diagonal[::2] - _onto_even(gram(left, left), gram(right, right), even)
        above = _fit(-gram(left, right), even)
    return BlockCholesky(tuple(rounds), inverse_factor(diagonal))


def solve(cholesky: BlockCholesky, right: Float[Array, "blocks size"]) -> Float[Array, "blocks size"]:
    """Solution y of S y = right: reduction to one block, and back substitution."""
    eliminated = []
    for r in cholesky.rounds:
        y = times(r.inverse, right[1::2])
        even = right.shape[0] - y.shape[0]
        right = right[::2] - _onto_even(transpose_times(r.left, y), transpose_times(r.right, y), even)
        eliminated.append(y)
    x = transpose_times(cholesky.last, times(cholesky.last, right))
    for r, y in zip(reversed(cholesky.rounds), reversed(eliminated), strict=True):
        odd = y.shape[0]
        y -= times(r.left, x[:odd]) + times(r.right, _fit(x[1:], odd))
        x = _interleave(x, transpose_times(r.inverse, y))
    return x


def _onto_even(from_left: Array, from_right: Array, even: int) -> Array:
    """Sum, at every even block, of the terms from the odd blocks on both sides."""
    zero = jnp.zeros_like(from_right[:1])
    return _fit(from_left, even) + _fit(jnp.concatenate([zero, from_right]), even)


def _fit(blocks: Array, count: int) -> Array:
    """The first ``count`` blocks, padded with zeros if there are fewer."""
    missing = max(count - blocks.shape[0], 0)
    return jnp.pad(blocks[:count], [(0, missing)] + [(0, 0)] * (blocks.ndim - 1))


def _interleave(
    even: Float[Array, "even size"], odd: Float[Array, "odd size"]
) -> Float[Array, "blocks size"]:
    pairs = jnp.stack([even, _fit(odd, even.shape[0])], axis=1)
    return pairs.reshape(-1, even.shape[1])[: even.shape[0] + odd.shape[0]]
