"""Exact discretisation under first-order hold by the state-transition matrix (equations 12-18).

Within an interval, control and dilation are linear in scaled time. The end of the interval as a function of
(z_i, u_{i+1}) is integrated by RK4; its forward-mode derivative integrates the variational equations with the
same steps (the inverse-free form), so that A, B- and B+ are the exact Jacobians of the discrete flow.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.problem import OptimalControlProblem


class Discretisation(eqx.Module):
    """The flow over every interval, linearised about a reference: y = flow + jacobian (w - w_ref).

    w_i = (z_i, u_{i+1}) are an interval's variables, the dilation counted as a control.
    """

    state: Float[Array, "*intervals states"]
    """States at the end of each interval when integrated from its first node."""
    cost: Float[Array, "*intervals"]
    """Running cost of each interval."""
    state_jacobian: Float[Array, "*intervals states inputs"]
    """[A, B-, B+]."""
    cost_jacobian: Float[Array, "*intervals inputs"]


def interval_inputs(problem: OptimalControlProblem, z: Float[Array, "nodes variables"]):
    """w_i = (z_i, u_{i+1}) for every interval."""
    return jnp.concatenate([z[:-1], z[1:, problem.state_size :]], axis=1)


@eqx.filter_jit  # traced once for all calls of one program
def discretise(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], substeps: int
) -> Discretisation:
    """Linearise the flow over every interval about the reference z.

    Args:
        problem: gives dynamics and running cost.
        z: reference, (nodes, variables).
        substeps: RK4 steps an interval; the error falls with their fourth power.
    """

    def linearised(w):
        push = lambda v: jax.jvp(lambda w: interval_flow(problem, w, substeps), (w,), (v,))  # noqa: E731
        (state, cost), (state_jacobian, cost_jacobian) = jax.vmap(push, out_axes=((None, None), (1, 0)))(
            jnp.eye(w.shape[0], dtype=w.dtype)
        )
        return Discretisation(state, cost, state_jacobian, cost_jacobian)

    return jax.vmap(linearised)(interval_inputs(problem, z))


def propagate(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], substeps: int):
    """End states and running costs of every interval, without derivatives."""
    return jax.vmap(lambda w: interval_flow(problem, w, substeps))(interval_inputs(problem, z))


def interval_flow(problem: OptimalControlProblem, w: Float[Array, "inputs"], substeps: int):
    """State at the end of one interval and the running cost over it, by RK4 in scaled time."""
    n = problem.state_size
    controls = problem.dynamics.control_size + 1
    state, first, last = w[:n], w[n : n + controls], w[n + controls :]
    width = 1.0 / (problem.nodes - 1)

    def rate(share, state):
        return problem.rate(state, first + share * (last - first))

    step = width / substeps

    def substep(carry, index):
        share = index / substeps
        return rk4_step(rate, carry, share, 1.0 / substeps, step), None

    zero = jnp.zeros((), w.dtype)
    (state, cost), _ = jax.lax.scan(substep, (state, zero), jnp.arange(substeps, dtype=w.dtype))
    return state, cost


def rk4_step(rate: Callable, carry, share, share_step: float, step: float):
    """One classical Runge-Kutta step of (state, cost); the control depends on the share of the interval."""
    state, cost = carry
    half = share + 0.5 * share_step
    k1, c1 = rate(share, state)
    k2, c2 = rate(half, state + 0.5 * step * k1)
    k3, c3 = rate(half, state + 0.5 * step * k2)
    k4, c4 = rate(share + share_step, state + step * k3)
    return state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), cost + step / 6.0 * (
        c1 + 2.0 * c2 + 2.0 * c3 + c4
    )
