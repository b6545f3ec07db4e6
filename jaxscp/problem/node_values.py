"""Values at the nodes: times, integrals over scaled time, and typical sizes."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Nodes, Scalar

LATE = 1e-12  # of scaled time: a place that rounding puts just before a node is at it


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


def interval_at(times: Nodes, dilation: Nodes, time: Scalar) -> tuple[Int[Array, ""], Scalar]:
    """Number of the interval at a time between the first node and the last, and the fraction of it in scaled time.

    Within an interval t grows by width (s0 f + (s1 - s0) f^2 / 2) at the fraction f: this takes the stable root.
    """
    intervals = times.shape[0] - 1
    i = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, intervals - 1)
    s0, s1 = dilation[i], dilation[i + 1]
    elapsed = (time - times[i]) * intervals
    root = jnp.sqrt(jnp.maximum(s0**2 + 2.0 * (s1 - s0) * elapsed, 0.0))
    return i, 2.0 * elapsed / (s0 + root)


def held_at(places: Float[Array, "places"], values: Nodes) -> Float[Array, "places"]:
    """Values that are constant after their node, at places in scaled time.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem.node_values import held_at
        >>> held_at(jnp.array([0.0, 0.4, 0.5, 0.9]), jnp.array([1.0, 3.0, 5.0])).tolist()
        [1.0, 1.0, 3.0, 3.0]
    """
    own = jnp.linspace(0.0, 1.0, values.shape[0])
    node = jnp.searchsorted(own, places + LATE, side="right") - 1
    return jnp.where(jnp.isnan(places), jnp.nan, values[jnp.clip(node, 0, values.shape[0] - 1)])


def integrate_nodes(rate: Nodes) -> Nodes:
    """Integral over scaled time, from 0 to each node, of a rate that is linear between nodes."""
    widths = 0.5 * (rate[1:] + rate[:-1]) / (rate.shape[0] - 1)
    return jnp.concatenate([jnp.zeros_like(widths[:1]), jnp.cumsum(widths)])
