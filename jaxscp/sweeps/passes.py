"""One pass through an interval by a Runge-Kutta method: its path, the tangent of that, and the slopes' curvature.

With s_j the state and control that slope j is taken at, S_j their Jacobian in the interval's variables, and kappa_j the
price of the slope, the curvature is sum_j S_j' D2(kappa_j . rate)(s_j) S_j.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import runge_kutta
from jaxscp.sweeps import compiled, played
from jaxscp.sweeps.intervals import Intervals, Pass, controls_at
from jaxscp.sweeps.slopes import record


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
    in_cpp = compiled.serves(w)
    # not the curvature, for each entry of which XLA would do again what leads to it
    by_tape = not only_cpu and prices is None
    slopes = record(intervals, w.shape[-1], prices is not None) if in_cpp or by_tape else None
    if slopes is None:
        return in_jax(intervals, w, prices)

    def cpu(w, prices):
        return compiled.sweep(intervals, slopes, w, prices)

    def elsewhere(w, prices):
        return played.sweep(intervals, slopes, w) if by_tape else in_jax(intervals, w, prices)

    if only_cpu:
        return cpu(w, prices)
    if not in_cpp:
        return elsewhere(w, prices)
    return jax.lax.platform_dependent(w, prices, cpu=cpu, default=elsewhere)


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
            rate = lambda share, x: intervals.rate(x[:n], controls_at(w, n, share))  # noqa: E731
            after, states = runge_kutta.step(intervals.method, rate, share, extended, size)
            shares = share + size * jnp.asarray(intervals.method.shares, w.dtype)
            return after, jnp.concatenate([states[:, :n], controls_at(w, n, shares)], axis=1)

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
