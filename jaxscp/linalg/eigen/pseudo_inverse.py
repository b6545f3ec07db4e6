"""Pseudo-inverse of a small matrix, from eigenvalues."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.linalg.eigen.dispatch import eigen


@jax.custom_jvp
def pseudo_inverse(matrix: Float[Array, "rows columns"]) -> Float[Array, "columns rows"]:
    """Moore-Penrose inverse A^+; singular values at rounding level count as zero.

    The eigenvalues of the symmetric matrix [0 A; A' 0] are plus and minus the singular values of A. Its pseudo-inverse
    [0 A'^+; A^+ 0] is therefore as accurate as one from a singular value decomposition.
    """
    rows, columns = matrix.shape
    both = jnp.block([[jnp.zeros((rows, rows)), matrix], [matrix.T, jnp.zeros((columns, columns))]])
    values, vectors = (v[0] for v in eigen(both[None]))
    cutoff = jnp.finfo(matrix.dtype).eps * 10 * max(rows, columns) * jnp.max(jnp.abs(values))
    inverse = jnp.reciprocal(jnp.where(jnp.abs(values) > cutoff, values, jnp.inf))
    return (vectors[rows:] * inverse) @ vectors[:rows].T


@pseudo_inverse.defjvp
def _(primals, tangents):
    """Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
    separate", 1973, equation 4.12; valid where the rank is constant."""
    (a,), (da,) = primals, tangents
    p = pseudo_inverse(a)
    left, right = da.T - (da.T @ a) @ p, da.T - p @ (a @ da.T)
    return p, -p @ da @ p + p @ (p.T @ left) + (right @ p.T) @ p
