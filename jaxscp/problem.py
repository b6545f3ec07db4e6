"""The general optimal control problem (equation 8) and its form over scaled time (equations 9-11).

    minimise    integral of running_cost(x, u) dt + terminal_cost(x_N, t_N)
    subject to  dx/dt = dynamics(x, u),  constraints at the nodes,  boundary conditions at both ends

Scaled time tau runs from 0 to 1; the dilation s = dt/dtau is one more control, so that the final time is free
and the mesh adapts. A node's variables are z = (x, u, s), or z = (x, phi, t, u, s) for an extended
problem, where phi is the running cost so far.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.constraints import Constraint
from jaxscp.dynamics import Dynamics
from jaxscp.types import Nodes, Scalar


class Boundary(eqx.Module):
    """Conditions ``function(state, time, parameters) = 0`` at one end of the flight.

    Linearised at the reference; a row that is zero everywhere is no condition, so that components can be
    freed without changing shapes.
    """

    function: Callable[..., Array] = eqx.field(static=True)
    parameters: Any


class FixedComponents(eqx.Module):
    """Parameters of ``fixed_components``."""

    value: Float[Array, "states"]
    fixed: Float[Array, "states"]
    """One where a component is fixed, zero where it is free."""


def fixed_components(state, time, p: FixedComponents) -> Float[Array, "states"]:
    """Each fixed component of the state at its value (equation 24)."""
    return p.fixed * (state - p.value)


class OptimalControlProblem(eqx.Module):
    """Dynamics, cost, constraints, boundary and time of one optimal control problem on N nodes."""

    dynamics: Dynamics
    running_cost: Callable[..., Array] = eqx.field(static=True)
    """(state, control, weights) -> cost per second."""
    terminal_cost: Callable[..., Array] = eqx.field(static=True)
    """(state, time, weights) -> cost."""
    weights: Any
    """Parameters of both costs: a pytree."""
    constraints: tuple[Constraint, ...]
    initial: Boundary
    final: Boundary
    dilation_min: Scalar
    """Least dt/dtau in seconds; the flight lasts at least this long."""
    dilation_max: Scalar
    """Greatest dt/dtau in seconds."""
    nodes: int = eqx.field(static=True)
    extended: bool = eqx.field(default=False, static=True)
    """Whether running cost and time are states (equation 11): needed where a constraint or a boundary uses
    time, and part of the paper's trust region. Otherwise both are eliminated, being linear in the rest."""

    @property
    def state_size(self) -> int:
        """Physical states and, if extended, running cost and time."""
        return self.dynamics.state_size + 2 * int(self.extended)

    @property
    def variables(self) -> int:
        """Size of z at one node."""
        return self.state_size + self.dynamics.control_size + 1

    def split(self, z: Float[Array, "variables"]):
        """A node's variables as (state, time or None, control, dilation)."""
        n, m = self.dynamics.state_size, self.dynamics.control_size
        time = z[n + 1] if self.extended else None
        return z[:n], time, z[-m - 1 : -1], z[-1]

    def join(
        self,
        states: Float[Array, "nodes states"],
        controls: Float[Array, "nodes controls"],
        dilation: Nodes,
    ) -> Float[Array, "nodes variables"]:
        """Stack a trajectory into node variables."""
        parts = [states, controls, dilation[:, None]]
        if self.extended:
            rate = jax.vmap(lambda x, u: self.running_cost(x, u, self.weights))(states, controls)
            parts[1:1] = [integrate_nodes(rate * dilation)[:, None], integrate_nodes(dilation)[:, None]]
        return jnp.concatenate(parts, axis=1)

    def rate(
        self, state: Float[Array, "states"], control: Float[Array, "controls"]
    ) -> tuple[Float[Array, "states"], Scalar]:
        """d/dtau of the (extended) state and of the running cost, at a control with the dilation last."""
        n = self.dynamics.state_size
        u, s = control[:-1], control[-1]
        derivative = s * self.dynamics(state[:n], u)
        cost = s * self.running_cost(state[:n], u, self.weights)
        if self.extended:
            derivative = jnp.concatenate([derivative, cost[None], s[None]])
        return derivative, cost


def node_times(dilation: Nodes) -> Nodes:
    """Times of the nodes in seconds: the exact integral of a first-order-hold dilation.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem import node_times
        >>> node_times(jnp.array([2.0, 2.0, 2.0])).tolist()
        [0.0, 1.0, 2.0]
    """
    return integrate_nodes(dilation)


def integrate_nodes(rate: Nodes) -> Nodes:
    """Integral over scaled time, from 0 to each node, of what is linear between nodes."""
    widths = 0.5 * (rate[1:] + rate[:-1]) / (rate.shape[0] - 1)
    return jnp.concatenate([jnp.zeros_like(widths[:1]), jnp.cumsum(widths)])
