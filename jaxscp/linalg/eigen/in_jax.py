"""Eigenvalues and nearest semidefinite matrices by ``jnp.linalg.eigh``."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def nearest(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size size"], Float[Array, "count"]]:
    """Nearest positive semidefinite matrix to each symmetric matrix, and the lowest eigenvalue of the latter."""
    values, vectors = jnp.linalg.eigh(matrices, symmetrize_input=True)
    raised = vectors * jnp.maximum(values, 0.0)[:, None, :]
    return raised @ jax.lax.transpose(vectors, (0, 2, 1)), values[:, 0]


def eigen(
    matrices: Float[Array, "count size size"],
) -> tuple[Float[Array, "count size"], Float[Array, "count size size"]]:
    """Eigenvalues, and eigenvectors as columns."""
    values, vectors = jnp.linalg.eigh(matrices, symmetrize_input=True)
    return values, vectors
