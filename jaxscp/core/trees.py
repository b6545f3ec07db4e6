"""Vector arithmetic on pytrees, and the names of their leaves."""

from collections.abc import Iterator
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from jaxscp.core.types import Flag, Scalar

Tree = TypeVar("Tree")


def tree_dot(a, b) -> Scalar:
    """Inner product of two like pytrees."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return jnp.sum(jnp.stack([jnp.vdot(x, y) for x, y in pairs]))


def tree_axpy(a, x, y):
    """a x + y for pytrees."""
    return jax.tree.map(lambda u, v: a * u + v, x, y)


def tree_negated(a):
    """-a for pytrees."""
    return jax.tree.map(jnp.negative, a)


def tree_where(condition: Flag, a: Tree, b: Tree) -> Tree:
    """a where the condition holds, else b, for pytrees of one structure."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)


def tree_max(a) -> Scalar:
    """Largest absolute entry of a pytree."""
    return jnp.max(jnp.stack([jnp.max(jnp.abs(x), initial=0.0) for x in jax.tree.leaves(a)]))


def named_leaves(tree: Any) -> Iterator[tuple[str, Any]]:
    """Leaves of a pytree, with the names that users know them by: ``airframe.body.mass``, say."""
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        yield jax.tree_util.keystr(path).lstrip("."), leaf
