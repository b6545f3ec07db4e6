"""Values at the nodes: times, integrals over scaled time, and typical sizes."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Nodes


def typical_sizes(z: Float[Array, "nodes variables"]) -> Float[Array, "variables"]:
    """The largest that each of a node's variables becomes, at least one.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem.node_values import typical_sizes
        >>> typical_sizes(jnp.array([[0.5, -3.0], [0.2, 2.0]])).tolist()
        [1.0, 3.0]
    """
    return jnp.maximum(jnp.max(jnp.abs(z), axis=0), 1.0)


def node_times(dilation: Nodes) -> Nodes:
    """Times of the nodes in seconds: the exact integral of a first-order-hold dilation.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem.node_values import node_times
        >>> node_times(jnp.array([2.0, 2.0, 2.0])).tolist()
        [0.0, 1.0, 2.0]
    """
    return integrate_nodes(dilation)


def integrate_nodes(rate: Nodes) -> Nodes:
    """Integral over scaled time, from 0 to each node, of a rate that is linear between nodes."""
    widths = 0.5 * (rate[1:] + rate[:-1]) / (rate.shape[0] - 1)
    return jnp.concatenate([jnp.zeros_like(widths[:1]), jnp.cumsum(widths)])
