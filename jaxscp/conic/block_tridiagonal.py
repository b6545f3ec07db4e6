"""Cholesky factorisation of a symmetric positive definite block tridiagonal matrix."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


class BlockCholesky(eqx.Module):
    """The factor L of S = L L', kept in the form that makes its sweeps one product a block.

    With D_l the diagonal blocks of L and B_l the block below D_l:
    """

    inverse: Float[Array, "blocks size size"]
    """D_l^-1."""
    forward: Float[Array, "blocks size size"]
    """D_l^-1 B_{l-1}: what a block of L y = r owes to the block before; zero for the first."""
    backward: Float[Array, "blocks size size"]
    """(B_l D_l^-1)': what a block of L' x = y owes to the block after; zero for the last."""


def factor(
    diagonal: Float[Array, "blocks size size"], above: Float[Array, "blocks size size"]
) -> BlockCholesky:
    """Factor S from its diagonal blocks and the blocks just right of them (the last of which is zero).

    Only this recursion and the two sweeps run along the chain; all else is batched over it.
    """

    def step(carry, blocks):
        diagonal, above = blocks
        lower = jnp.linalg.cholesky(diagonal - carry, symmetrize_input=False)
        below = solve_triangular(lower, above, lower=True)  # B_l'
        return below.T @ below, (lower, below)

    size = diagonal.shape[-1]
    eye = jnp.eye(size, dtype=diagonal.dtype)
    _, (lower, below) = jax.lax.scan(step, jnp.zeros_like(eye), (diagonal, above))
    inverse = jax.vmap(lambda D: solve_triangular(D, eye, lower=True))(lower)
    forward = jnp.einsum("lij,lkj->lik", inverse[1:], below[:-1])
    backward = jnp.einsum("lji,ljk->lik", inverse, below)
    first = jnp.zeros((1, size, size), diagonal.dtype)
    return BlockCholesky(inverse, jnp.concatenate([first, forward]), backward)


def solve(cholesky: BlockCholesky, right: Float[Array, "blocks size"]) -> Float[Array, "blocks size"]:
    """Solve S y = right by a forward and a backward sweep."""

    def sweep(carry, block):
        matrix, own = block
        value = own - matrix @ carry
        return value, value

    zero = jnp.zeros_like(right[0])
    own = jnp.einsum("lij,lj->li", cholesky.inverse, right)
    _, y = jax.lax.scan(sweep, zero, (cholesky.forward, own))
    own = jnp.einsum("lji,lj->li", cholesky.inverse, y)
    _, x = jax.lax.scan(sweep, zero, (cholesky.backward, own), reverse=True)
    return x
