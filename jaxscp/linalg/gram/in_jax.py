"""The sums, one constraint after another."""

import jax.numpy as jnp

from jaxscp.linalg.gram.system import GramSums, WeightedRows


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """Sums over all constraints, of which there must be one."""
    matrix = sum(jnp.einsum("iprw,ipr,iprv->iwv", p.jacobian, p.weight, p.jacobian) for p in parts)
    for part in parts:
        if part.along is not None:
            row = jnp.einsum("ipr,iprw->ipw", part.along, part.jacobian)
            matrix += jnp.einsum("ipw,ipv->iwv", row, row)
    return GramSums(
        jnp.asarray(matrix),
        jnp.asarray(sum(jnp.einsum("iprw,iprk->ikw", p.jacobian, p.sides) for p in parts)),
    )
