"""One pass through intervals: what they give, its Jacobian, and the curvature of its priced sum.

Where all is arithmetic its operations are found first: C++ plays them on a CPU, if it was compiled. Where only the end
is asked, those of the slopes are a kernel on an NVIDIA GPU, and on other devices JAX plays them. Derivatives of a pass
are those of the pass in JAX.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from jaxscp.backends import cuda
from jaxscp.backends.codegen import launch, tracing
from jaxscp.backends.libraries import choose
from jaxscp.integration import in_cpp, in_cuda, in_jax, in_tape
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals


def outcomes(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData
) -> IntervalOutputs:
    """What every interval gives."""
    return _outcomes(intervals, w, given)


def linear(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """That, and its Jacobian."""
    return _linear(intervals, w, given)


def curved(
    intervals: Intervals, w: Float[Array, "intervals inputs"], given: IntervalData, prices: IntervalOutputs
) -> tuple[IntervalOutputs, IntervalOutputs, Float[Array, "intervals inputs inputs"]]:
    """Those, and the second derivatives of the sum of all that is given times its price."""
    return _curved(intervals, w, given, prices)


@eqx.filter_custom_jvp
def _outcomes(intervals: Intervals, w: Array, given: IntervalData) -> IntervalOutputs:
    cpu = _in_cpp(intervals, w, given, order=0)
    (found,) = choose(cpu, lambda w, given: (in_jax.outcomes(intervals, w, given),), w, given)
    return found


@_outcomes.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.outcomes, primals, tangents)


@eqx.filter_custom_jvp
def _linear(intervals: Intervals, w: Array, given: IntervalData) -> tuple[IntervalOutputs, IntervalOutputs]:
    on_gpu = _by_kernel(intervals, w)

    def elsewhere(w, given):
        # what a kernel does on this process's device is not traced again in full
        if on_gpu is None and jax.default_backend() != "cpu" and intervals.watch.nothing:
            with contextlib.suppress(tracing.CannotTrace):
                return in_tape.linear(intervals, w)
        return in_jax.linear(intervals, w, given)

    return choose(_in_cpp(intervals, w, given, order=1), elsewhere, w, given, cuda=on_gpu)


@_linear.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.linear, primals, tangents)


@eqx.filter_custom_jvp
def _curved(intervals: Intervals, w: Array, given: IntervalData, prices: IntervalOutputs):
    cpu = _in_cpp(intervals, w, given, order=2)
    return choose(cpu, lambda *args: in_jax.curved(intervals, *args), w, given, prices)


@_curved.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.curved, primals, tangents)


def _in_cpp(intervals: Intervals, w: Array, given: IntervalData, order: int) -> Callable[..., Any] | None:
    """The pass in C++ as a function of (w, given, prices); None where it cannot be."""
    if not in_cpp.serves(w):
        return None
    try:
        found = in_cpp.record(intervals, w.shape[-1], given, order)
    except tracing.CannotTrace:
        return None
    return lambda w, given, prices=None: in_cpp.sweep(intervals, found, w, given, prices, order)


def _by_kernel(intervals: Intervals, w: Array) -> Callable[..., Any] | None:
    """The pass and its Jacobian by a kernel, as a function of (w, given); None where there is none."""
    capability = cuda.capability()
    if capability is None or not in_cuda.serves(intervals, w):
        return None
    try:
        found = in_cuda.record(intervals, w.shape[-1])
    except tracing.CannotTrace:
        return None
    image = launch.image(found.text, capability, "the sweep")
    return None if image is None else lambda w, _: in_cuda.sweep(intervals, found, image, w)
