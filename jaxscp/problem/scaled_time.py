"""The problem over scaled time (equations 9-11): the form that is solved.

Scaled time tau runs from 0 to 1; the dilation s = dt/dtau is one more control, so that the final time is free
and the mesh adapts. A node's variables are z = (x, u, s), in units of the problem's scale. More variables join them
where the problem needs them:

- after x: a copy of the first state, which does not change, for conditions that couple both ends;
- then the running cost so far, phi, and the time, t;
- after u: a slack for each soft constraint.

Functions of the user see x, u and t alone, in the user's units: the methods here translate.
"""

import math
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp.cones.cone import NonNegative, SymmetricCone
from jaxscp.core.types import Nodes, Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.boundary import Boundary
from jaxscp.problem.constraint import Constraint
from jaxscp.problem.cost import Cost
from jaxscp.problem.node_values import integrate_nodes, node_times
from jaxscp.problem.sizes import Sizes


class PathConstraint(Constraint):
    """A constraint of a problem over scaled time: no field is left to a default."""

    cone: SymmetricCone = NonNegative()
    active: Bool[Array, "nodes"] = None  # pyright: ignore[reportAssignmentType]
    tolerance: Float[Array, "..."] = None  # pyright: ignore[reportAssignmentType]
    size: Float[Array, "..."] | None = None
    """Typical size of the values, or of each row, by which the solver divides; None is one."""
    slack: int | None = eqx.field(default=None, static=True)
    """Number of its slack, if it is soft."""
    tolerance_by_size: bool = eqx.field(default=False, static=True)
    """Whether the tolerance follows from the size, which the user did not state."""

    def in_solver_units(self, value: Float[Array, "rows"]) -> Array:
        """Values divided by their typical size."""
        return value if self.size is None else value / self.size

    def solver_value(self, value: Float[Array, "rows"], slacks: Float[Array, "slacks"]) -> Array:
        """Values in the solver's units, with the slack added where the constraint is soft."""
        value = self.in_solver_units(value)
        if self.slack is None:
            return value
        return value + slacks[self.slack] * self.cone.identity(value.shape[-1])


class ScaledTimeProblem(eqx.Module):
    """Dynamics, cost, constraints and boundary on N nodes."""

    dynamics: Dynamics
    cost: Cost
    boundary: Boundary
    constraints: tuple[PathConstraint, ...]
    dilation_min: Scalar | Nodes
    """Least dt/dtau, of all nodes or of each; the trajectory lasts at least this long."""
    dilation_max: Scalar | Nodes
    """Greatest dt/dtau, of all nodes or of each."""
    checks: tuple[PathConstraint, ...]
    sizes: Sizes | None
    """None is one for each."""
    nodes: int = eqx.field(static=True)
    carries_cost: bool = eqx.field(default=False, static=True)
    """Whether the running cost so far is a state (equation 11). Only the paper's trust region depends on it."""
    carries_time: bool = eqx.field(default=False, static=True)
    """Whether time is a state (equation 11): needed where a function reads the time."""
    zero_order_hold: tuple[int, ...] = eqx.field(default=(), static=True)
    curved_end: bool = eqx.field(default=False, static=True)
    """Whether the terminal cost has second derivatives."""
    mesh_weight: Scalar | None = None
    """Cost of half the squared difference of two neighbours' dilations; None is no such cost."""

    # --- layout ---

    @property
    def dynamic_states(self) -> int:
        """States of the dynamics, and of the copy of the first state."""
        return self.dynamics.state_size * (1 if self.boundary.coupled is None else 2)

    @property
    def state_size(self) -> int:
        """All states: of the dynamics and their copy, running cost, and time."""
        return self.dynamic_states + self.carries_cost + self.carries_time

    @property
    def slacks(self) -> int:
        """Number of soft constraints."""
        return sum(c.slack is not None for c in self.constraints)

    @property
    def variables(self) -> int:
        """Size of z at one node."""
        return self.state_size + self.dynamics.control_size + self.slacks + 1

    def split_state(self, state: Float[Array, "states"]) -> tuple[Array, Scalar]:
        """The user's state and the time, zero where the problem does not carry it."""
        x = state[: self.dynamics.state_size]
        t = state[self.dynamic_states + self.carries_cost] if self.carries_time else jnp.zeros((), x.dtype)
        return (x, t) if self.sizes is None else (x * self.sizes.state, t * self.sizes.time)

    def split_control(self, control: Float[Array, "inputs"]) -> tuple[Array, Array, Scalar]:
        """(the user's control, slacks, dilation in the user's units)."""
        m = self.dynamics.control_size
        u, slack, s = control[:m], control[m:-1], control[-1]
        return (u, slack, s) if self.sizes is None else (u * self.sizes.control, slack, s * self.sizes.time)

    def split(self, z: Float[Array, "variables"]):
        """A node's variables as the user's (state, time, control, dilation)."""
        state, time = self.split_state(z[: self.state_size])
        control, _, dilation = self.split_control(z[self.state_size :])
        return state, time, control, dilation

    def join(
        self,
        states: Float[Array, "nodes states"],
        controls: Float[Array, "nodes controls"],
        dilation: Nodes,
    ) -> Float[Array, "nodes variables"]:
        """The user's trajectory as node variables."""
        carried = [jnp.broadcast_to(states[0], states.shape)] * (self.boundary.coupled is not None)
        times = integrate_nodes(dilation)
        if self.carries_cost:
            rate = jax.vmap(self.running_cost)(states, controls, times, self.node_data())
            carried.append(integrate_nodes(rate * dilation)[:, None])
        if self.carries_time:
            carried.append(times[:, None])
        slacks = [
            self._violation(c, states, controls, times)[:, None]
            for c in self.constraints
            if c.slack is not None
        ]
        whole = jnp.concatenate([states, *carried, controls, *slacks, dilation[:, None]], axis=1)
        if self.sizes is None:
            return whole
        one, sizes = jnp.ones((), states.dtype), self.sizes
        unit = [sizes.state] * (1 + (self.boundary.coupled is not None))
        unit += [sizes.cost[None]] * self.carries_cost + [sizes.time[None]] * self.carries_time
        unit += [sizes.control] + [one[None]] * len(slacks) + [sizes.time[None]]
        return whole / jnp.concatenate(unit)

    def _violation(self, c: PathConstraint, states, controls, times) -> Nodes:
        """Violation of a constraint at the nodes, in the solver's units."""

        def one(*point):
            return jnp.maximum(c.cone.violation(c.in_solver_units(c.value(*point))), 0.0)

        return jax.vmap(one)(states, controls, times, c.node_parameters())

    # --- dynamics and cost ---

    def node_data(self) -> Float[Array, "nodes data"]:
        """Parameters of the running cost that differ from node to node, a row for each node."""
        leaves = jax.tree.leaves(self.cost.node_parameters())
        none = jnp.zeros((self.nodes, 0))
        return jnp.concatenate([none, *(leaf.reshape(self.nodes, -1) for leaf in leaves)], axis=1)

    def _of_node(self, data: Float[Array, "data"]):
        """The cost's ``node_parameters`` at a point, from ``node_data`` there."""
        leaves, tree = jax.tree.flatten(self.cost.node_parameters())
        ends = [0]
        for leaf in leaves:
            ends.append(ends[-1] + math.prod(leaf.shape[1:]))
        parts = [data[a:b].reshape(v.shape[1:]) for a, b, v in zip(ends[:-1], ends[1:], leaves, strict=True)]
        return jax.tree.unflatten(tree, parts)

    def running_cost(self, state, control, time, data) -> Scalar:
        """Cost per second at a point, in the user's units; ``data`` are ``node_data`` there."""
        return self.cost.running_at(state, control, time, self._of_node(data))

    def _slack_weights(self) -> Iterator[tuple[int, Scalar]]:
        """Number and weight of every slack; weights are per unit of the solver's slack."""
        for c in self.constraints:
            if c.slack is not None:
                yield c.slack, jnp.asarray(c.soft) * (1.0 if c.size is None else c.size)

    def rate(
        self, state: Float[Array, "states"], control: Float[Array, "inputs"], data: Float[Array, "data"]
    ) -> tuple[Float[Array, "states"], Scalar]:
        """d/dtau of all states and of the running cost, at a control with the dilation last."""
        (x, t), (u, slack, s) = self.split_state(state), self.split_control(control)
        derivative, cost = s * self.dynamics(x, u, t), s * self.running_cost(x, u, t, data)
        for number, weight in self._slack_weights():
            cost += s * weight * slack[number]
        if self.sizes is not None:
            derivative, cost = derivative / self.sizes.state, cost / self.sizes.cost
        copy = [jnp.zeros_like(derivative)] * (self.boundary.coupled is not None)
        carried = [cost[None]] * self.carries_cost + [control[-1:]] * self.carries_time
        return jnp.concatenate([derivative, *copy, *carried]), cost

    def slope(
        self, state: Float[Array, "states"], control: Float[Array, "inputs"]
    ) -> Float[Array, "extended"]:
        """Derivative of all states, and of the running cost after them, by the fraction of an interval.

        ``node_data`` follow the control.
        """
        own = self.variables - self.state_size
        # of one interval: the derivative is proportional to it
        dilation = control[own - 1 : own] / (self.nodes - 1)
        return jnp.append(*self.rate(state, jnp.append(control[: own - 1], dilation), control[own:]))

    def terminal_cost(self, z: Float[Array, "nodes variables"]) -> Scalar:
        """Terminal cost of node variables; the final time is the integral of the dilation."""
        state, time, _, _ = self.split(z[-1])
        if not self.carries_time:
            time = node_times(z[:, -1])[-1]
            time = time if self.sizes is None else time * self.sizes.time
        last = jax.tree.map(lambda v: v[-1], self.cost.node_parameters())
        cost = self.cost.terminal_at(state, time, last)
        return cost if self.sizes is None else cost / self.sizes.cost

    def terminal_hessian(self, z: Float[Array, "nodes variables"]) -> Float[Array, "states states"]:
        """Second derivatives of the terminal cost in the last state; a curved one finds its time there."""
        n = self.state_size
        return jax.hessian(lambda state: self.terminal_cost(z.at[-1, :n].set(state)))(z[-1, :n])

    # --- constraints ---

    def value_at(self, c: PathConstraint, state, control, node_parameters) -> Float[Array, "rows"]:
        """Values of a constraint at a whole state and a control with the dilation last."""
        (x, t), (u, slack, _) = self.split_state(state), self.split_control(control)
        return c.solver_value(c.value(x, u, t, node_parameters), slack)

    def value_across(self, c: PathConstraint, first, last, node_parameters) -> Float[Array, "rows"]:
        """Values of a constraint across an interval, on the controls with dilation at both of its ends."""
        (u0, slack, s0), (u1, _, s1) = self.split_control(first), self.split_control(last)
        ends = jnp.append(u0, s0), jnp.append(u1, s1)
        value = c.with_parameters(c.function)(*ends, 1.0 / (self.nodes - 1), node_parameters)
        return c.solver_value(value, slack)

    def node_limits(self, z: Float[Array, "nodes variables"]) -> Float[Array, "nodes limits"]:
        """Slacks of every node's own limits: both of the dilation, then zero for each slack variable."""
        slack = z[:, self.variables - 1 - self.slacks : -1]
        limits = jnp.stack([z[:, -1] - self.dilation_min, self.dilation_max - z[:, -1]], axis=1)
        return jnp.concatenate([limits, slack], axis=1) if self.slacks else limits

    def node_limits_jacobian(self, dtype) -> Float[Array, "limits variables"]:
        """Jacobian of ``node_limits`` at any node."""
        unit = jnp.eye(self.variables, dtype=dtype)
        return jnp.concatenate([unit[-1:], -unit[-1:], unit[self.variables - 1 - self.slacks : -1]])
