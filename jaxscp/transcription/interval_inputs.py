"""Inputs of the integration over every interval, and derivatives in the interval's own variables.

An interval's variables are w_i = (z_i, u_{i+1}). The integration takes controls that are linear between two nodes. Two
things make its inputs another affine function of w:

- parameters of the running cost that differ from node to node: they are further linear controls;
- controls under zero-order hold: the one at the last node is replaced by the one at the first.

Where these or the mesh leave the optimum undetermined, a small quadratic cost of every interval picks one
(``QuadraticCost``).
"""

import equinox as eqx
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


class QuadraticCost(eqx.Module):
    """1/2 w' hessian w of every interval: a cost that makes an optimum unique, and hardly changes it.

    - The last node's own value of a control under zero-order hold has no effect. It is drawn to the value before, which
      costs nothing at the optimum.
    - Under a constant control, all meshes are equally good. Dilations of neighbours are drawn together, at
      ``mesh_weight``.
    """

    hessian: Float[Array, "intervals inputs inputs"]

    def value(self, w: Float[Array, "intervals inputs"]) -> Float[Array, "intervals"]:
        """Cost of every interval."""
        return 0.5 * jnp.einsum("iv,ivw,iw->i", w, self.hessian, w)

    def gradient(self, w: Float[Array, "intervals inputs"]) -> Float[Array, "intervals inputs"]:
        """Gradient of every interval's cost."""
        return jnp.einsum("ivw,iw->iv", self.hessian, w)

    @classmethod
    def of(cls, problem: ScaledTimeProblem) -> "QuadraticCost | None":
        """That of a problem; None if it needs none."""
        if not problem.zero_order_hold and problem.mesh_weight is None:
            return None
        states, own = problem.state_size, problem.variables - problem.state_size
        identity = np.eye(states + 2 * own)
        change = identity[states + own :] - identity[states : states + own]
        hessian = jnp.zeros((problem.nodes - 1, *identity.shape))
        held = change[np.array(problem.zero_order_hold, int)]
        hessian = hessian.at[-1].add(held.T @ held)
        if problem.mesh_weight is not None:
            hessian += problem.mesh_weight * np.outer(change[-1], change[-1])
        return cls(hessian)


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
