"""Cholesky factorisation of a symmetric positive definite block tridiagonal matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


class BlockCholesky(eqx.Module):
    """The factor L of S = L L': blocks on the diagonal and just below it."""

    diagonal: Float[Array, "blocks size size"]
    below: Float[Array, "blocks size size"]
    """Row block l + 1, column block l; the last entry is unused."""


def factor(
    diagonal: Float[Array, "blocks size size"], above: Float[Array, "blocks size size"]
) -> BlockCholesky:
    """Factor S from its diagonal blocks and the blocks just right of them (the last of which is unused).

    Only this recursion runs along the chain in sequence; all else in the interior point is batched over it.
    """

    def step(carry, blocks):
        diagonal, above = blocks
        lower = jnp.linalg.cholesky(diagonal - carry, symmetrize_input=False)
        below = solve_triangular(lower, above, lower=True).T
        return below @ below.T, (lower, below)

    size = diagonal.shape[-1]
    _, (lower, below) = jax.lax.scan(step, jnp.zeros((size, size), diagonal.dtype), (diagonal, above))
    return BlockCholesky(lower, below)


def solve(cholesky: BlockCholesky, right: Float[Array, "blocks size"]) -> Float[Array, "blocks size"]:
    """Solve S y = right by a forward and a backward sweep."""

    def forward(carry, block):
        lower, below, r = block
        y = solve_triangular(lower, r - carry, lower=True)
        return below @ y, y

    def backward(carry, block):
        lower, below, y = block
        x = solve_triangular(lower, y - below.T @ carry, lower=True, trans=1)
        return x, x

    zero = jnp.zeros_like(right[0])
    _, y = jax.lax.scan(forward, zero, (cholesky.diagonal, cholesky.below, right))
    _, x = jax.lax.scan(backward, zero, (cholesky.diagonal, cholesky.below, y), reverse=True)
    return x
