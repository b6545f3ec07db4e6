"""Inputs of the integration over every interval, and derivatives in the interval's own variables.

An interval's variables are w_i = (z_i, u_{i+1}). The integration takes controls that are linear between two nodes. Two
things make its inputs another affine function of w:

- parameters of the running cost that differ from node to node: they are further linear controls;
- controls under zero-order hold: the one at the last node is replaced by the one at the first. The last node's own
  value then has no effect. A quadratic cost, zero at the optimum, draws it to the value before, so that it is unique.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.layout import interval_variables


def integration_inputs(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]
) -> Float[Array, "intervals inputs"]:
    """Inputs of the integration of every interval."""
    w, data = interval_variables(problem, z), problem.node_data()
    if (matrix := _matrix(problem)) is None:
        return w
    states, own = problem.state_size, problem.variables - problem.state_size
    first = jnp.concatenate([jnp.zeros((w.shape[0], states + own), w.dtype), data[:-1]], axis=1)
    last = jnp.concatenate([jnp.zeros((w.shape[0], own), w.dtype), data[1:]], axis=1)
    return w @ matrix.T + jnp.concatenate([first, last], axis=1)


def in_variables(problem: ScaledTimeProblem, jacobian: Array) -> Array:
    """A Jacobian in w, from one in the integration's inputs; both are the last axis."""
    matrix = _matrix(problem)
    return jacobian if matrix is None else jacobian @ jnp.asarray(matrix)


def hessian_in_variables(problem: ScaledTimeProblem, hessian: Array) -> Array:
    """A Hessian in w, from one in the integration's inputs."""
    matrix = _matrix(problem)
    return hessian if matrix is None else jnp.asarray(matrix.T) @ hessian @ jnp.asarray(matrix)


def last_value_cost(problem: ScaledTimeProblem, w: Float[Array, "inputs"]) -> Float[Array, ""]:
    """The cost that draws the last node's controls under zero-order hold to the value before."""
    return 0.5 * jnp.sum((_difference(problem) @ w) ** 2)


def last_value_hessian(problem: ScaledTimeProblem) -> np.ndarray:
    """Its second derivatives."""
    difference = _difference(problem)
    return difference.T @ difference


def _difference(problem: ScaledTimeProblem) -> np.ndarray:
    """Matrix from w to the change of every control under zero-order hold."""
    states, own = problem.state_size, problem.variables - problem.state_size
    identity = np.eye(states + 2 * own)
    chosen = np.array(problem.zero_order_hold, int)
    return identity[states + own + chosen] - identity[states + chosen]


def _matrix(problem: ScaledTimeProblem) -> np.ndarray | None:
    """Jacobian of the integration's inputs in w; None for the identity."""
    states, own = problem.state_size, problem.variables - problem.state_size
    data = problem.node_data().shape[1]
    if not data and not problem.zero_order_hold:
        return None
    identity = np.eye(states + 2 * own)
    first, last = identity[states : states + own], identity[states + own :].copy()
    for number in problem.zero_order_hold:
        last[number] = first[number]
    constant = np.zeros((data, states + 2 * own))
    return np.concatenate([identity[:states], first, constant, last, constant])
