"""The cost: a running part along the trajectory, and a terminal part."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxscp.core.types import Scalar


def no_running_cost(state, control, time, parameters) -> Scalar:
    """Zero."""
    return jnp.zeros((), state.dtype)


def no_terminal_cost(state, time, parameters) -> Scalar:
    """Zero."""
    return jnp.zeros((), state.dtype)


class Cost(eqx.Module):
    """Integral of ``running`` over time, plus ``terminal`` (equation 8).

    Args:
        running: (state, control, time, parameters) -> cost per second; pure.
        terminal: (state, time, parameters) -> cost, at the end; ``time`` is the final time.
        parameters: a pytree of numbers and arrays, for both.
        per_node: whether arrays of ``parameters`` have the nodes as leading axis. Between nodes the running cost finds
            them linearly interpolated in scaled time; the terminal cost finds those of the last node.

    Example:
        >>> import jaxscp
        >>> minimum_time = jaxscp.Cost(terminal=lambda x, t, p: t)
        >>> energy_and_time = jaxscp.Cost(running=lambda x, u, t, weight: 1.0 + weight * u @ u, parameters=0.1)
    """

    running: Callable[..., Any] = eqx.field(static=True, default=no_running_cost)
    terminal: Callable[..., Any] = eqx.field(static=True, default=no_terminal_cost)
    parameters: Any = ()
    per_node: bool = eqx.field(static=True, default=False)

    def node_parameters(self) -> Any:
        """Those that differ from node to node; ``running_at`` and ``terminal_at`` know the others."""
        return self.parameters if self.per_node else ()

    def running_at(self, state, control, time, node_parameters: Any) -> Scalar:
        """Cost per second at a point."""
        return self.running(state, control, time, self._parameters(node_parameters))

    def terminal_at(self, state, time, node_parameters: Any) -> Scalar:
        """Terminal cost, from the parameters of the last node."""
        return self.terminal(state, time, self._parameters(node_parameters))

    def _parameters(self, node_parameters: Any) -> Any:
        return node_parameters if self.per_node else self.parameters
