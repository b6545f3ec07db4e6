"""Batched products and Cholesky factors of small dense matrices, one at every location k of a chain.

Products with vectors are sums, which XLA fuses with their neighbours. A batched dot is a call of its own, which costs
more than the arithmetic at these sizes. Triangular factors are inverted once, so that each later solve is a product.
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float


def times(matrix: Float[Array, "chain ... columns"], vector: Float[Array, "chain columns"]) -> jax.Array:
    """A_k v_k, summed over the last axis."""
    between = (1,) * (matrix.ndim - 2)
    return jnp.sum(matrix * vector.reshape(vector.shape[0], *between, vector.shape[1]), axis=-1)


def transpose_times(
    matrix: Float[Array, "chain ... columns"], vector: Float[Array, "chain ..."]
) -> jax.Array:
    """A_k' v_k, summed over all axes between the first and the last."""
    return jnp.sum(matrix * vector[..., None], axis=tuple(range(1, vector.ndim)))


def gram(a: Float[Array, "chain rows i"], b: Float[Array, "chain rows j"]) -> Float[Array, "chain i j"]:
    """A_k' B_k."""
    return jnp.einsum("kri,krj->kij", a, b)


def times_transposed(a: Float[Array, "chain i columns"], b: Float[Array, "chain j columns"]) -> jax.Array:
    """A_k B_k'."""
    return jnp.einsum("kic,kjc->kij", a, b)


def inverse_factor(matrix: Float[Array, "chain size size"]) -> Float[Array, "chain size size"]:
    """L_k^-1, where A_k = L_k L_k'."""
    lower = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    eye = jnp.broadcast_to(jnp.eye(matrix.shape[-1], dtype=matrix.dtype), matrix.shape)
    return solve_triangular(lower, eye, lower=True)
