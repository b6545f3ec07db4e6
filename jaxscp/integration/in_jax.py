"""Integration in JAX, with its derivatives.

Let s_j be the state and control at slope j, S_j their Jacobian in w, and kappa_j the adjoint of the slope: the gradient
of the weighted sum of outputs in a perturbation of the slope. The Hessian of the weighted sum is

    sum_j S_j' D2(kappa_j . rate)(s_j) S_j + D2 Phi, along the path's tangent,

with Phi the weighted sum as a function of the path at the points. The formula is exact. Forward over reverse mode gives
the same, but integrates again for every direction.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.integration import tableaus
from jaxscp.integration.intervals import (
    IntervalData,
    IntervalOutputs,
    Intervals,
    controls_at,
    outputs_of_path,
)

Path = Float[Array, "after extended"]


def evaluate(
    intervals: Intervals, w: Float[Array, "intervals inputs"], data: IntervalData
) -> IntervalOutputs:
    """Outputs of every interval."""
    return jax.vmap(lambda w, data: outputs_of_path(intervals, w, integrate(intervals, w), data))(w, data)


def integrate(intervals: Intervals, w: Float[Array, "inputs"], perturbation: Array | None = None) -> Path:
    """State and running cost of one interval, at every point but the first.

    Args:
        intervals: the integration.
        w: the interval's variables.
        perturbation: (steps, stages, states + 1), added to the slopes.
    """
    n = intervals.states

    @jax.checkpoint  # reverse mode stores the state of a stage alone
    def rate(fraction, extended):
        return intervals.rate(extended[:n], controls_at(w, n, fraction))

    start = jnp.append(w[:n], 0.0)
    path = tableaus.integrate(intervals.method, rate, start, intervals.steps, perturbation)
    return path[intervals.steps_per_subinterval - 1 :: intervals.steps_per_subinterval]


def linearise(
    intervals: Intervals, w: Float[Array, "intervals inputs"], data: IntervalData
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outputs and their Jacobians, by forward mode through the integration."""

    def one(w, data):
        value = lambda w: outputs_of_path(intervals, w, integrate(intervals, w), data)  # noqa: E731
        jvp = lambda v: jax.jvp(value, (w,), (v,))  # noqa: E731
        return jax.vmap(jvp, out_axes=(None, -1))(jnp.eye(w.shape[0], dtype=w.dtype))

    return jax.vmap(one)(w, data)


def linearise_with_hessian(
    intervals: Intervals,
    w: Float[Array, "intervals inputs"],
    data: IntervalData,
    multipliers: IntervalOutputs,
) -> tuple[IntervalOutputs, IntervalOutputs, Float[Array, "intervals inputs inputs"]]:
    """Outputs, their Jacobians, and the Hessian of their sum weighted by the multipliers."""
    return jax.vmap(lambda *one: _linearise_with_hessian(intervals, *one))(w, data, multipliers)


def _linearise_with_hessian(
    intervals: Intervals, w: Float[Array, "inputs"], data: IntervalData, multipliers: IntervalOutputs
):
    """Outputs, Jacobian and Hessian of one interval."""
    directions = jnp.eye(w.shape[0], dtype=w.dtype)

    def weighted_sum(path, w):
        found = outputs_of_path(intervals, w, path, data)
        pairs = jax.tree.leaves(multipliers), jax.tree.leaves(found)
        return sum(map(jnp.vdot, *pairs), jnp.zeros((), w.dtype))

    zeros = jnp.zeros((intervals.steps, intervals.method.stages, intervals.states + 1), w.dtype)
    adjoints = jax.grad(lambda v: weighted_sum(integrate(intervals, w, v), w))(zeros)
    path, tangent, hessian_of_rate = _integrate_tangents(intervals, w, adjoints)
    along_path = lambda dpath, dw: jax.jvp(  # noqa: E731
        lambda p, w: outputs_of_path(intervals, w, p, data), (path, w), (dpath, dw)
    )
    found, jacobian = jax.vmap(along_path, in_axes=-1, out_axes=(None, -1))(tangent, directions)
    hessian_of_outputs = jax.hessian(lambda d: weighted_sum(path + tangent @ d, w + d))(jnp.zeros_like(w))
    return found, jacobian, hessian_of_rate + hessian_of_outputs


def _integrate_tangents(
    intervals: Intervals, w: Float[Array, "inputs"], adjoints: Float[Array, "steps stages extended"]
) -> tuple[Path, Float[Array, "after extended inputs"], Float[Array, "inputs inputs"]]:
    """Path at the points, its Jacobian in w, and the sum of S_j' D2(kappa_j . rate) S_j."""
    n, size = intervals.states, 1.0 / intervals.steps
    directions = jnp.eye(w.shape[0], dtype=w.dtype)

    def weighted_rate(argument, adjoint):
        return jnp.dot(intervals.rate(argument[:n], argument[n:]), adjoint)

    def forward(carry, at):
        extended, tangent, hessian = carry
        begin, adjoint = at

        def step(extended, w):
            rate = lambda fraction, x: intervals.rate(x[:n], controls_at(w, n, fraction))  # noqa: E731
            after, states = tableaus.step(intervals.method, rate, begin, extended, size)
            fractions = begin + size * jnp.asarray(intervals.method.c, w.dtype)
            return after, jnp.concatenate([states[:, :n], controls_at(w, n, fractions)], axis=1)

        jvp = lambda dx, dw: jax.jvp(step, (extended, w), (dx, dw))  # noqa: E731
        found = jax.vmap(jvp, in_axes=-1, out_axes=(None, -1))(tangent, directions)
        (extended, arguments), (tangent, stage_tangent) = found
        second = jax.vmap(jax.hessian(weighted_rate))(arguments, adjoint)
        hessian += jnp.tensordot(stage_tangent, second @ stage_tangent, axes=((0, 1), (0, 1)))
        return (extended, tangent, hessian), (extended, tangent)

    start = (
        jnp.append(w[:n], 0.0),
        jnp.eye(n + 1, w.shape[0], dtype=w.dtype).at[n].set(0.0),
        jnp.zeros_like(directions),
    )
    begins = size * jnp.arange(intervals.steps, dtype=w.dtype)
    (_, _, hessian), (path, tangents) = jax.lax.scan(forward, start, (begins, adjoints))
    points = slice(intervals.steps_per_subinterval - 1, None, intervals.steps_per_subinterval)
    return path[points], tangents[points], hessian
