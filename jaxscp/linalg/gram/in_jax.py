"""Gram matrices in JAX, one constraint after another."""

import jax.numpy as jnp

from jaxscp.linalg.gram.system import GramSums, WeightedRows


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """J' W J and J' v, summed over one constraint or more."""
    matrix = sum(jnp.einsum("iprw,ipr,iprv->iwv", p.jacobian, p.weight, p.jacobian) for p in parts)
    for part in parts:
        if part.rank_one is not None:
            row = jnp.einsum("ipr,iprw->ipw", part.rank_one, part.jacobian)
            matrix += jnp.einsum("ipw,ipv->iwv", row, row)
    return GramSums(
        jnp.asarray(matrix),
        jnp.asarray(sum(jnp.einsum("iprw,iprk->ikw", p.jacobian, p.vectors) for p in parts)),
    )
