"""The pass as JAX differentiates it.

With s_j the state and control that slope j is taken at, S_j their Jacobian in w, and kappa_j the price of the slope,
how the priced sum changes where something is added to it, the second derivatives are

    sum_j S_j' D2(kappa_j . rate)(s_j) S_j + D2 Phi, along the path's tangent,

Phi being what follows from the path at the points. Nothing is approximate here. Forward over reverse mode through the
integration gives the same, but goes through the chain anew for every direction.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.integration import tableaus
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals, controls_at, outcome

Path = Float[Array, "after extended"]


def outcomes(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData
) -> IntervalOutputs:
    """Of every interval."""
    return jax.vmap(lambda w, given: outcome(intervals, w, fly(intervals, w), given))(w, given)


def fly(intervals: Intervals, w: Float[Array, "inputs"], push: Array | None = None) -> Path:
    """The state and the cost so far at every point but the first; ``push`` is added to the slopes."""
    n = intervals.states

    @jax.checkpoint  # reverse mode keeps no more of a stage than its state
    def rate(share, extended):
        return intervals.rate(extended[:n], controls_at(w, n, share))

    path = tableaus.integrate(intervals.method, rate, jnp.append(w[:n], 0.0), intervals.steps, push)
    return path[intervals.every - 1 :: intervals.every]


def linear(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outcomes and their Jacobians, by forward mode through the integration."""

    def one(w, given):
        value = lambda w: outcome(intervals, w, fly(intervals, w), given)  # noqa: E731
        push = lambda v: jax.jvp(value, (w,), (v,))  # noqa: E731
        return jax.vmap(push, out_axes=(None, -1))(jnp.eye(w.shape[0], dtype=w.dtype))

    return jax.vmap(one)(w, given)


def curved(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData, prices: IntervalOutputs
) -> tuple[IntervalOutputs, IntervalOutputs, Float[Array, "intervals inputs inputs"]]:
    """Outcomes, their Jacobians, and the second derivatives of their priced sum."""
    return jax.vmap(lambda *lane: _curved(intervals, *lane))(w, given, prices)


def _curved(intervals: Intervals, w: Float[Array, "inputs"], given: IntervalData, prices: IntervalOutputs):
    """Of one interval."""
    directions = jnp.eye(w.shape[0], dtype=w.dtype)

    def priced(path, w):
        found = outcome(intervals, w, path, given)
        return sum(map(jnp.vdot, jax.tree.leaves(prices), jax.tree.leaves(found)), jnp.zeros((), w.dtype))

    nothing = jnp.zeros((intervals.steps, intervals.method.stages, intervals.states + 1), w.dtype)
    slope_prices = jax.grad(lambda push: priced(fly(intervals, w, push), w))(nothing)
    path, tangent, curvature = _sweep(intervals, w, slope_prices)
    directional = lambda dpath, dw: jax.jvp(
        lambda p, w: outcome(intervals, w, p, given), (path, w), (dpath, dw)
    )  # noqa: E731
    found, jacobian = jax.vmap(directional, in_axes=-1, out_axes=(None, -1))(tangent, directions)
    straight = jax.hessian(lambda d: priced(path + tangent @ d, w + d))(jnp.zeros_like(w))
    return found, jacobian, curvature + straight


def _sweep(
    intervals: Intervals, w: Float[Array, "inputs"], prices: Float[Array, "steps stages extended"]
) -> tuple[Path, Float[Array, "after extended inputs"], Float[Array, "inputs inputs"]]:
    """The path at the points, its tangent, and the curvature of the slopes."""
    n, size = intervals.states, 1.0 / intervals.steps
    directions = jnp.eye(w.shape[0], dtype=w.dtype)

    def priced(argument, price):
        return jnp.dot(intervals.rate(argument[:n], argument[n:]), price)

    def forward(carry, at):
        extended, tangent, curvature = carry
        share, price = at

        def step(extended, w):
            rate = lambda share, x: intervals.rate(x[:n], controls_at(w, n, share))  # noqa: E731
            after, states = tableaus.step(intervals.method, rate, share, extended, size)
            shares = share + size * jnp.asarray(intervals.method.shares, w.dtype)
            return after, jnp.concatenate([states[:, :n], controls_at(w, n, shares)], axis=1)

        push = lambda dx, dw: jax.jvp(step, (extended, w), (dx, dw))  # noqa: E731
        pushed = jax.vmap(push, in_axes=-1, out_axes=(None, -1))(tangent, directions)
        (extended, arguments), (tangent, moved) = pushed
        second = jax.vmap(jax.hessian(priced))(arguments, price)
        curvature += jnp.tensordot(moved, second @ moved, axes=((0, 1), (0, 1)))
        return (extended, tangent, curvature), (extended, tangent)

    start = (
        jnp.append(w[:n], 0.0),
        jnp.eye(n + 1, w.shape[0], dtype=w.dtype).at[n].set(0.0),
        jnp.zeros_like(directions),
    )
    begins = size * jnp.arange(intervals.steps, dtype=w.dtype)
    (_, _, curvature), (path, tangents) = jax.lax.scan(forward, start, (begins, prices))
    kept = slice(intervals.every - 1, None, intervals.every)
    return path[kept], tangents[kept], curvature
