"""Order of the variables: a node's z = (state, controls, dilation), an interval's w_i = (z_i, u_{i+1})."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.problem.node_values import node_times
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory


def interval_variables(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]):
    """w_i = (z_i, u_{i+1}) of every interval, (intervals, inputs)."""
    return jnp.concatenate([z[:-1], z[1:, problem.state_size :]], axis=1)


def sum_onto_nodes(
    problem: ScaledTimeProblem, intervals: Float[Array, "intervals inputs"]
) -> Float[Array, "nodes variables"]:
    """Sums over intervals, by node variables: the adjoint of ``interval_variables``."""
    stage, states = problem.variables, problem.state_size
    nodes = jnp.zeros((problem.nodes, stage), intervals.dtype).at[:-1].set(intervals[:, :stage])
    return nodes.at[1:, states:].add(intervals[:, stage:])


def stage_sizes(problem: ScaledTimeProblem, sizes: Float[Array, "variables"]) -> Float[Array, "inputs"]:
    """Typical sizes of an interval's variables, from the sizes of a node's variables."""
    return jnp.concatenate([sizes, sizes[problem.state_size :]])


def cost_gradient(
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    running: Float[Array, "intervals inputs"],
) -> Float[Array, "nodes inputs"]:
    """Gradient of the whole cost by stages, from the gradient ``running`` of every interval's running cost."""
    terminal = jax.grad(problem.terminal_cost)(z)
    idle = running.shape[1] - problem.variables
    return jnp.pad(terminal, ((0, 0), (0, idle))).at[:-1].add(running)


def trajectory_of(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]) -> Trajectory:
    """The trajectory of node variables."""
    state, _, control, dilation = jax.vmap(problem.split)(z)
    return Trajectory(node_times(dilation), state, control, dilation, problem.zero_order_hold)
