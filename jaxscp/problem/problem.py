"""The general optimal control problem (equation 8) and its form over scaled time (equations 9-11).

    minimise    integral of running_cost(x, u) dt + terminal_cost(x_N, t_N)
    subject to  dx/dt = dynamics(x, u),  constraints at the nodes,  boundary conditions at both ends

Scaled time tau runs from 0 to 1; the dilation s = dt/dtau is one more control, so that the final time is free
and the mesh adapts. A node's variables are z = (x, u, s); where the problem carries them as states, the running
cost so far, phi, and the time, t, come after x.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Nodes, Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.constraint import Constraint


class Boundary(eqx.Module):
    """Conditions ``function(state, time, parameters) = 0`` at one end of the trajectory.

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
    carries_cost: bool = eqx.field(default=False, static=True)
    """Whether the running cost so far is a state (equation 11). Only the paper's trust region depends on it."""
    carries_time: bool = eqx.field(default=False, static=True)
    """Whether time is a state (equation 11): needed where a constraint or a boundary uses time."""

    @property
    def state_size(self) -> int:
        """Physical states, and running cost and time where the problem carries them."""
        return self.dynamics.state_size + self.carries_cost + self.carries_time

    @property
    def variables(self) -> int:
        """Size of z at one node."""
        return self.state_size + self.dynamics.control_size + 1

    def split_state(self, state: Float[Array, "states"]):
        """A whole state as (physical state, time or None)."""
        n = self.dynamics.state_size
        return state[:n], state[n + self.carries_cost] if self.carries_time else None

    def split(self, z: Float[Array, "variables"]):
        """A node's variables as (state, time or None, control, dilation)."""
        state, time = self.split_state(z[: self.state_size])
        return state, time, z[-self.dynamics.control_size - 1 : -1], z[-1]

    def join(
        self,
        states: Float[Array, "nodes states"],
        controls: Float[Array, "nodes controls"],
        dilation: Nodes,
    ) -> Float[Array, "nodes variables"]:
        """Stack a trajectory into node variables."""
        parts = [states, controls, dilation[:, None]]
        if self.carries_time:
            parts.insert(1, integrate_nodes(dilation)[:, None])
        if self.carries_cost:
            rate = jax.vmap(lambda x, u: self.running_cost(x, u, self.weights))(states, controls)
            parts.insert(1, integrate_nodes(rate * dilation)[:, None])
        return jnp.concatenate(parts, axis=1)

    def rate(
        self, state: Float[Array, "states"], control: Float[Array, "controls"]
    ) -> tuple[Float[Array, "states"], Scalar]:
        """d/dtau of the whole state and of the running cost, at a control with the dilation last."""
        n = self.dynamics.state_size
        u, s = control[:-1], control[-1]
        derivative = s * self.dynamics(state[:n], u)
        cost = s * self.running_cost(state[:n], u, self.weights)
        carried = [cost[None]] * self.carries_cost + [s[None]] * self.carries_time
        return jnp.concatenate([derivative, *carried]), cost

    def slope(
        self, state: Float[Array, "states"], control: Float[Array, "inputs"]
    ) -> Float[Array, "extended"]:
        """Derivative of the whole state, and of the running cost after it, by the fraction of an interval."""
        dilation = control[-1:] / (self.nodes - 1)  # of one interval: the derivative is proportional to it
        return jnp.append(*self.rate(state, jnp.append(control[:-1], dilation)))


class Condition(eqx.Module):
    """Conditions at one end of the trajectory, to first order about its state."""

    jacobian: Float[Array, "conditions states"]
    value: Float[Array, "conditions"]
    """Zero where they hold."""


def start_condition(
    problem: OptimalControlProblem, state: Float[Array, "states"]
) -> Float[Array, "conditions"]:
    """Value of the conditions at the start, where time (and running cost) are zero."""
    physical, time = problem.split_state(state)
    value = problem.initial.function(physical, time, problem.initial.parameters)
    return jnp.concatenate([value, state[problem.dynamics.state_size :]])


def end_condition(
    problem: OptimalControlProblem, state: Float[Array, "states"]
) -> Float[Array, "conditions"]:
    """Value of the conditions at the end."""
    physical, time = problem.split_state(state)
    return problem.final.function(physical, time, problem.final.parameters)


def end_residuals(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"]
) -> tuple[Float[Array, "initial"], Float[Array, "final"]]:
    """Values of the conditions at the start and at the end; zero where they hold."""
    n = problem.state_size
    return start_condition(problem, z[0, :n]), end_condition(problem, z[-1, :n])


def linearised_ends(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"]
) -> tuple[Condition, Condition]:
    """The conditions at the start and at the end."""
    n = problem.state_size

    def one(condition, state):
        value = functools.partial(condition, problem)
        return Condition(jax.jacfwd(value)(state), value(state))

    return one(start_condition, z[0, :n]), one(end_condition, z[-1, :n])


def typical_sizes(z: Float[Array, "nodes variables"]) -> Float[Array, "variables"]:
    """The largest that each of a node's variables becomes, at least one.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem.problem import typical_sizes
        >>> typical_sizes(jnp.array([[0.5, -3.0], [0.2, 2.0]])).tolist()
        [1.0, 3.0]
    """
    return jnp.maximum(jnp.max(jnp.abs(z), axis=0), 1.0)


def node_times(dilation: Nodes) -> Nodes:
    """Times of the nodes in seconds: the exact integral of a first-order-hold dilation.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.problem.problem import node_times
        >>> node_times(jnp.array([2.0, 2.0, 2.0])).tolist()
        [0.0, 1.0, 2.0]
    """
    return integrate_nodes(dilation)


def integrate_nodes(rate: Nodes) -> Nodes:
    """Integral over scaled time, from 0 to each node, of a rate that is linear between nodes."""
    widths = 0.5 * (rate[1:] + rate[:-1]) / (rate.shape[0] - 1)
    return jnp.concatenate([jnp.zeros_like(widths[:1]), jnp.cumsum(widths)])


def terminal_cost(problem: OptimalControlProblem, z: Float[Array, "nodes variables"]) -> Scalar:
    """Terminal cost of node variables; the final time is the integral of the dilation."""
    state, time, _, _ = problem.split(z[-1])
    time = node_times(z[:, -1])[-1] if time is None else time
    return problem.terminal_cost(state, time, problem.weights)
