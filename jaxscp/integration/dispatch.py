"""Outputs of intervals, their Jacobian and the Hessian of their weighted sum, by the fastest implementation.

Functions that are arithmetic alone become tapes, which C++ evaluates on a CPU if the library was compiled. Without path
outputs, the Jacobian comes from a kernel on an NVIDIA GPU, and from the tape in JAX on other devices. JAX
differentiates its own implementation in place of these functions.
"""

import contextlib
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import launch, tracing
from jaxscp.backends.serving import warn_slow
from jaxscp.integration import in_cpp, in_cuda, in_jax, in_tape
from jaxscp.integration.intervals import IntervalData, IntervalOutputs, Intervals


def evaluate(
    intervals: Intervals, w: Float[Array, "intervals inputs"], data: IntervalData
) -> IntervalOutputs:
    """Outputs of every interval."""
    return _evaluate(intervals, w, data)


def linearise(
    intervals: Intervals, w: Float[Array, "intervals inputs"], data: IntervalData
) -> tuple[IntervalOutputs, IntervalOutputs]:
    """Outputs of every interval and their Jacobian in w."""
    return _linearise(intervals, w, data)


def linearise_with_hessian(
    intervals: Intervals,
    w: Float[Array, "intervals inputs"],
    data: IntervalData,
    multipliers: IntervalOutputs,
) -> tuple[IntervalOutputs, IntervalOutputs, Float[Array, "intervals inputs inputs"]]:
    """Outputs of every interval, their Jacobian, and the Hessian in w of their sum weighted by the multipliers."""
    return _linearise_with_hessian(intervals, w, data, multipliers)


def served_by(intervals: Intervals, w: Array, data: IntervalData, order: int) -> Int[Array, ""]:
    """Index into ``BACKENDS`` of the implementation with derivatives up to an order."""
    key = _key(intervals, w, data, order)
    if key not in _AVAILABLE:
        _implementations(intervals, w, data, order)
    cpp, cuda = _AVAILABLE[key]
    return libraries.serving(cpp=cpp, cuda=cuda)


@eqx.filter_custom_jvp
def _evaluate(intervals: Intervals, w: Array, data: IntervalData) -> IntervalOutputs:
    cpp = _implementations(intervals, w, data, order=0).cpp
    (found,) = libraries.dispatch(cpp, lambda w, data: (in_jax.evaluate(intervals, w, data),), w, data)
    return found


@_evaluate.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.evaluate, primals, tangents)


@eqx.filter_custom_jvp
def _linearise(intervals: Intervals, w: Array, data: IntervalData) -> tuple[IntervalOutputs, IntervalOutputs]:
    compiled = _implementations(intervals, w, data, order=1)

    def default(w, data):
        # where a kernel runs, this is a fallback for other devices: recording a tape for it would cost time
        if compiled.cuda is None and jax.default_backend() != "cpu" and intervals.path_outputs.empty:
            with contextlib.suppress(tracing.CannotTrace):
                return in_tape.linearise(intervals, w)
        return in_jax.linearise(intervals, w, data)

    return libraries.dispatch(compiled.cpp, default, w, data, cuda=compiled.cuda)


@_linearise.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.linearise, primals, tangents)


@eqx.filter_custom_jvp
def _linearise_with_hessian(intervals: Intervals, w: Array, data: IntervalData, multipliers: IntervalOutputs):
    cpp = _implementations(intervals, w, data, order=2).cpp
    default = lambda *args: in_jax.linearise_with_hessian(intervals, *args)  # noqa: E731
    return libraries.dispatch(cpp, default, w, data, multipliers)


@_linearise_with_hessian.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.linearise_with_hessian, primals, tangents)


class _Implementations(NamedTuple):
    """Compiled implementations; None for one that does not support the intervals."""

    cpp: Callable[..., Any] | None
    cuda: Callable[..., Any] | None


# Whether there is (C++, CUDA) for intervals that were seen: to ask again would record the tapes again, which is slow.
_AVAILABLE: dict[Hashable, tuple[bool, bool]] = {}


def _implementations(intervals: Intervals, w: Array, data: IntervalData, order: int) -> _Implementations:
    found = _Implementations(
        _in_cpp(intervals, w, data, order), _in_cuda(intervals, w) if order == 1 else None
    )
    _AVAILABLE[_key(intervals, w, data, order)] = found.cpp is not None, found.cuda is not None
    return found


def _key(intervals: Intervals, w: Array, data: IntervalData, order: int) -> Hashable:
    leaves, structure = jax.tree.flatten((intervals, w, data))
    return order, structure, tuple((jnp.shape(v), jnp.result_type(v)) for v in leaves)


def _in_cpp(intervals: Intervals, w: Array, data: IntervalData, order: int) -> Callable[..., Any] | None:
    """Integration in C++ as a function of (w, data, multipliers); None if C++ does not support these intervals."""
    if not in_cpp.supports(w):
        return None
    try:
        tapes = in_cpp.record(intervals, w.shape[-1], data, order)
    except tracing.CannotTrace as error:
        warn_slow(f"compiled C++ cannot integrate this problem ({error}); JAX does, and is slower")
        return None
    return lambda w, data, multipliers=None: in_cpp.integrate(intervals, tapes, w, data, multipliers, order)


def _in_cuda(intervals: Intervals, w: Array) -> Callable[..., Any] | None:
    """Outputs and Jacobian by a kernel, as a function of (w, data); None if there is no kernel."""
    capability = cuda.capability()
    if capability is None or not in_cuda.supports(intervals, w):
        return None
    try:
        kernel = in_cuda.record(intervals, w.shape[-1])
    except tracing.CannotTrace:
        return None
    cubin = launch.cubin(kernel.text, capability, "the integration")
    return None if cubin is None else lambda w, _: in_cuda.linearise(intervals, kernel, cubin, w)
