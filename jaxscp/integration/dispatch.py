"""Outputs of intervals, their Jacobian and the Hessian of their weighted sum, by the fastest implementation.

Functions that are arithmetic alone become tapes. C++ evaluates them on a CPU if the library was compiled, and kernels
evaluate them on an NVIDIA GPU. Without path outputs, other devices take the Jacobian from the tape in JAX. JAX
differentiates its own implementation in place of these functions.
"""

import contextlib
import functools
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.backends import cuda, launch, libraries
from jaxscp.backends.codegen import tracing
from jaxscp.backends.serving import warn_slow
from jaxscp.integration import in_cpp, in_cuda, in_cuda_blocks, in_jax, in_tape, interval_tapes
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
    compiled = _implementations(intervals, w, data, order=0)
    default = lambda w, data: (in_jax.evaluate(intervals, w, data),)  # noqa: E731
    (found,) = libraries.dispatch(compiled.cpp, default, w, data, cuda=compiled.cuda)
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
    compiled = _implementations(intervals, w, data, order=2)
    default = lambda *args: in_jax.linearise_with_hessian(intervals, *args)  # noqa: E731
    return libraries.dispatch(compiled.cpp, default, w, data, multipliers, cuda=compiled.cuda)


@_linearise_with_hessian.def_jvp
def _(primals, tangents):
    return eqx.filter_jvp(in_jax.linearise_with_hessian, primals, tangents)


class _Implementations(NamedTuple):
    """Compiled functions of (w, data, multipliers); None for one that does not support the intervals."""

    cpp: Callable[..., Any] | None
    cuda: Callable[..., Any] | None


# Whether there is (C++, CUDA) for intervals that were seen: to ask again would record the tapes again, which is slow.
_AVAILABLE: dict[Hashable, tuple[bool, bool]] = {}


def _implementations(intervals: Intervals, w: Array, data: IntervalData, order: int) -> _Implementations:
    find = _by_registers if order == 1 and intervals.path_outputs.empty else _by_blocks
    record = functools.cache(lambda: interval_tapes.record(intervals, w.shape[-1], data, order))
    found = _Implementations(_in_cpp(intervals, w, record, order), find(intervals, w, record, order))
    _AVAILABLE[_key(intervals, w, data, order)] = found.cpp is not None, found.cuda is not None
    return found


def _key(intervals: Intervals, w: Array, data: IntervalData, order: int) -> Hashable:
    leaves, structure = jax.tree.flatten((intervals, w, data))
    return order, structure, tuple((jnp.shape(v), jnp.result_type(v)) for v in leaves)


Record = Callable[[], interval_tapes.IntervalTapes]


def _in_cpp(intervals: Intervals, w: Array, record: Record, order: int) -> Callable[..., Any] | None:
    """Integration in C++; None if C++ does not support these intervals."""
    if not in_cpp.supports(w):
        return None
    try:
        tapes = record()
    except tracing.CannotTrace as error:
        warn_slow(f"compiled C++ cannot integrate this problem ({error}); JAX does, and is slower")
        return None
    return lambda w, data, multipliers=None: in_cpp.integrate(intervals, tapes, w, data, multipliers, order)


def _by_blocks(intervals: Intervals, w: Array, record: Record, order: int) -> Callable[..., Any] | None:
    """Integration by CUDA kernels with path outputs; None if there are none, or none is needed."""
    capability = cuda.capability()
    if capability is None or not in_cuda_blocks.supports(w) or intervals.path_outputs.empty:
        return None
    try:
        tapes = record()
    except tracing.CannotTrace as error:
        warn_slow(f"no CUDA kernel can integrate this problem ({error}); JAX does, and is slower")
        return None
    kernels = in_cuda_blocks.kernels(intervals, tapes, w.shape[-1], order, capability)
    if kernels is None:
        return None
    return lambda w, data, multipliers=None: in_cuda_blocks.integrate(
        intervals, tapes, kernels, w, data, multipliers, order
    )


def _by_registers(intervals: Intervals, w: Array, _: Record, order: int) -> Callable[..., Any] | None:
    """Outputs and Jacobian by a kernel with tangents in registers; None if there is no kernel."""
    capability = cuda.capability()
    if capability is None or not in_cuda.supports(intervals, w):
        return None
    try:
        source = in_cuda.record(intervals, w.shape[-1])
    except tracing.CannotTrace:
        return None
    cubin = launch.cubin(source.text, capability, "the integration")
    return None if cubin is None else lambda w, *_: in_cuda.linearise(intervals, source, cubin, w)
