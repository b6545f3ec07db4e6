"""The pseudo-inverse of a small matrix, from eigenvalues."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.linalg.eigen.dispatch import eigen


@jax.custom_jvp
def pseudo_inverse(matrix: Float[Array, "rows columns"]) -> Float[Array, "columns rows"]:
    """Moore and Penrose's inverse: singular values of rounding's size count as zero.

    The symmetric matrix [0 A; A' 0] has plus and minus the singular values of A as its eigenvalues, and so its
    pseudo-inverse, [0 A'^+; A^+ 0], is as accurate as one from a singular value decomposition.
    """
    rows, columns = matrix.shape
    both = jnp.block([[jnp.zeros((rows, rows)), matrix], [matrix.T, jnp.zeros((columns, columns))]])
    values, vectors = (v[0] for v in eigen(both[None]))
    small = jnp.finfo(matrix.dtype).eps * 10 * max(rows, columns) * jnp.max(jnp.abs(values))
    inverse = jnp.reciprocal(jnp.where(jnp.abs(values) > small, values, jnp.inf))
    return (vectors[rows:] * inverse) @ vectors[:rows].T


@pseudo_inverse.defjvp
def _(primals, tangents):
    """Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
    separate", 1973, equation 4.12; for changes that leave the rank as it is."""
    (a,), (da,) = primals, tangents
    p = pseudo_inverse(a)
    beyond, idle = da.T - (da.T @ a) @ p, da.T - p @ (a @ da.T)
    return p, -p @ da @ p + p @ (p.T @ beyond) + (idle @ p.T) @ p
