"""One pass through an interval by a Runge-Kutta method: its path, the tangent of that, and the slopes' curvature.

With s_j the state and control that slope j is taken at, S_j their Jacobian in the interval's variables, and kappa_j the
price of the slope, the curvature is sum_j S_j' D2(kappa_j . rate)(s_j) S_j.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import runge_kutta
from jaxscp.sweeps import compiled, played
from jaxscp.sweeps.slopes import record


class Intervals(eqx.Module):
    """What a pass goes through, and how.

    An interval's variables are w = (state, first controls, last controls); controls are linear between.

    Args:
        rate: (state, controls) -> slope of the state by the share of the interval, and of a cost after it; a pytree.
        states: how many.
        method: of integration.
        steps: of an interval.
        every: of how many steps the last one is kept.
    """

    rate: Callable[..., Array]
    states: int = eqx.field(static=True)
    method: runge_kutta.Method = eqx.field(static=True)
    steps: int = eqx.field(static=True)
    every: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.steps % self.every:
            raise ValueError(f"every: {self.steps} steps are no multiple of {self.every}")

    def controls(self, w: Float[Array, "inputs"], share: Array) -> Array:
        """At a share of the interval."""
        first, last = jnp.split(w[self.states :], 2)
        return first + share * (last - first)


class Pass(eqx.Module):
    """What was found, the intervals as leading axis. A path has the cost so far after the state."""

    path: Float[Array, "intervals kept extended"]
    tangent: Float[Array, "intervals kept extended inputs"]
    """The path's Jacobian."""
    curvature: Float[Array, "intervals inputs inputs"] | None
    """Of the slopes at their prices, if these are given."""


def sweep(
    intervals: Intervals,
    w: Float[Array, "intervals inputs"],
    prices: Float[Array, "intervals steps stages extended"] | None = None,
) -> Pass:
    """Go through intervals once.

    Where the rate is arithmetic its operations are found first: C++ plays them on a CPU, if it was compiled, and JAX on
    other devices. Derivatives are those of the pass in JAX.
    """
    return _sweep(intervals, w, prices)


@eqx.filter_custom_jvp
def _sweep(intervals: Intervals, w: Array, prices: Array | None) -> Pass:
    only_cpu = jax.default_backend() == "cpu"  # which spares tracing what another device would run
    slopes = None
    if compiled.serves(w) or not only_cpu:
        slopes = record(intervals, w.shape[-1], prices is not None)
    if slopes is None:
        return in_jax(intervals, w, prices)

    def in_cpp(w, prices):
        return Pass(*compiled.sweep(intervals, slopes, w, prices))

    def by_tape(w, prices):
        if prices is not None:  # a compiler that fuses curvature does again for every entry what leads to it
            return in_jax(intervals, w, prices)
        return Pass(*played.sweep(intervals, slopes, w))

    if only_cpu:
        return in_cpp(w, prices)
    if not compiled.serves(w):
        return by_tape(w, prices)
    return jax.lax.platform_dependent(w, prices, cpu=in_cpp, default=by_tape)


@_sweep.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax, primals, tangents)


def in_jax(intervals: Intervals, w: Array, prices: Array | None) -> Pass:
    """The pass as JAX does it."""
    return Pass(*jax.vmap(lambda w, prices: _one(intervals, w, prices))(w, prices))


def _one(
    intervals: Intervals, w: Float[Array, "inputs"], prices: Array | None
) -> tuple[Array, Array, Array | None]:
    n, size = intervals.states, 1.0 / intervals.steps
    directions = jnp.eye(w.shape[0], dtype=w.dtype)

    def priced(argument, price):
        return jnp.dot(intervals.rate(argument[:n], argument[n:]), price)

    def forward(carry, at):
        extended, tangent, curvature = carry
        share, price = at

        def step(extended, w):
            rate = lambda share, x: intervals.rate(x[:n], intervals.controls(w, share))  # noqa: E731
            after, states = runge_kutta.step(intervals.method, rate, share, extended, size)
            shares = share + size * jnp.asarray(intervals.method.shares, w.dtype)
            controls = jax.vmap(lambda share: intervals.controls(w, share))(shares)
            return after, jnp.concatenate([states[:, :n], controls], axis=1)

        push = lambda dx, dw: jax.jvp(step, (extended, w), (dx, dw))  # noqa: E731
        pushed = jax.vmap(push, in_axes=-1, out_axes=(None, -1))(tangent, directions)
        (extended, arguments), (tangent, moved) = pushed
        if price is not None:
            second = jax.vmap(jax.hessian(priced))(arguments, price)
            curvature += jnp.tensordot(moved, second @ moved, axes=((0, 1), (0, 1)))
        return (extended, tangent, curvature), (extended, tangent)

    start = (
        jnp.append(w[:n], 0.0),
        jnp.eye(n + 1, w.shape[0], dtype=w.dtype).at[n].set(0.0),
        None if prices is None else jnp.zeros_like(directions),
    )
    begins = size * jnp.arange(intervals.steps, dtype=w.dtype)
    (_, _, curvature), (path, tangents) = jax.lax.scan(forward, start, (begins, prices))
    kept = slice(intervals.every - 1, None, intervals.every)
    return path[kept], tangents[kept], curvature
