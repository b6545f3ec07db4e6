"""Derivatives by the implicit function theorem: of first order, each by one linear system."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscp.core.types import Flag

Tree = TypeVar("Tree")


def symmetric_solve(
    matrix: Callable[[Tree], Tree], solve: Callable[[Tree], Tree], right: Tree, defined: Flag
) -> Tree:
    """Solve with a symmetric matrix, so that it has forward and reverse mode: the matrix is its own transpose.

    Args:
        matrix: its product with a pytree like ``right``.
        solve: its inverse's product; need not be linear to the last bit, nor finite where it is not defined.
        right: the right-hand side.
        defined: whether there is a solution. If not, it is NaN, and zero for a right-hand side of zeros, so that a
            batch element can be masked.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.implicit import symmetric_solve
        >>> half = lambda right: symmetric_solve(lambda v: 2.0 * v, lambda v: 0.5 * v, right, jnp.array(True))
        >>> jax.grad(lambda v: half(v).sum())(jnp.ones(2))
        Array([0.5, 0.5], dtype=float64)
    """
    # one vector: all of it is linear in the tangents, or none
    flat, unravel = ravel_pytree(right)

    def product(v):
        return ravel_pytree(matrix(unravel(v)))[0]

    def guarded(_, v):
        return jnp.where(defined, ravel_pytree(solve(unravel(v)))[0], undefined(v))

    return unravel(
        jax.lax.custom_linear_solve(product, flat, guarded, transpose_solve=guarded, symmetric=True)
    )


def undefined(right: Float[Array, "_"]) -> Float[Array, "_"]:
    """The value in place of a missing solution: NaN, but zero for a right-hand side of zeros."""
    return jnp.where(jnp.any(right != 0), jnp.nan, jnp.zeros_like(right))


@jax.custom_jvp
def undefined_unless(defined: Flag, given: Tree) -> Tree:
    """The given floats; if not defined, NaN, in derivatives too, but zero for those requested with weight zero.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.core.implicit import undefined_unless
        >>> weighted = lambda v, weight: weight * undefined_unless(jnp.array(False), v)
        >>> float(jax.grad(weighted)(2.0, 3.0)), float(jax.grad(lambda v: jnp.where(True, v, weighted(v, 1.0)))(2.0))
        (nan, 1.0)
    """
    return jax.tree.map(lambda v: jnp.where(defined, v, jnp.nan), given)


@undefined_unless.defjvp
def _undefined_change(primals, tangents):
    defined, given = primals
    same = lambda v: v  # noqa: E731
    return undefined_unless(defined, given), symmetric_solve(same, same, tangents[1], defined)


@jax.custom_jvp
def first_order_only(given: Tree) -> Tree:
    """The argument of a derivative rule: to differentiate the rule again is an error, not a wrong number."""
    return given


@first_order_only.defjvp
def _refuse(primals, tangents):
    raise TypeError(
        "plans and conic layers have first derivatives only: take second ones as differences of those"
    )
