"""The flight as one kernel of an NVIDIA GPU, for float64.

As JAX, every stage of every step is a few kernels, thousands one after another for a flight.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import functions, launch, tracing
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.dynamics.base import Dynamics
from jaxscp.verification.integrator import cuda_source

AGREEMENT = 1e-9  # of slopes: far above rounding


def flight(
    dynamics: Dynamics, start: Float[Array, "n"], control: Float[Array, "nodes m"], samples: int
) -> Callable[..., Any] | None:
    """What flies, as a function of (start, control, dilation), on JAX's default device; None where that is no GPU or
    has no kernel for it."""
    here = cuda.capability()
    if here is None or not launch.available() or not libraries.in_float64((start, control)):
        return None
    try:
        slope = record(dynamics)
    except tracing.CannotTrace:
        return None
    code = launch.cubin(cuda_source.kernel(slope, control.shape[0] - 1, samples), here, "the flight")
    return (
        None if code is None else functools.partial(states, dynamics, slope, code, cuda_source.LANES, samples)
    )


def record(dynamics: Dynamics) -> TapedFunction:
    """The slope of the state, as a function of the state and the controls.

    Raises:
        CannotTrace: if it is not arithmetic alone.
    """
    n = dynamics.state_size
    return functions.record(lambda a: dynamics(a[:n], a[n:]), n + dynamics.control_size, (), order=0)


def states(
    dynamics: Dynamics,
    slope: TapedFunction,
    machine_code: bytes,
    lanes: int,
    samples: int,
    start: Float[Array, "n"],
    control: Float[Array, "nodes m"],
    dilation: Float[Array, "nodes"],
) -> Float[Array, "intervals samples n"]:
    """States at points of every interval, by a kernel of which so many lanes fly together.

    A judge trusts nobody: from the first interval on at whose begin the kernel's slope is not that of the dynamics, as
    JAX finds it, there is no flight. To rounding, that is, which may be that of the largest of the slopes.
    """
    intervals, n = dilation.shape[0] - 1, start.shape[0]
    w = jnp.concatenate([start, control.ravel(), dilation])[None]
    shapes = (1, intervals, samples, n), (1, intervals, n)
    found, slopes = (
        v[0]
        for v in launch.call(
            machine_code, w, launch.hoisted_constants(slope), shapes, lanes, cuda_source.THREADS
        )
    )
    expected = jax.vmap(dynamics)(found[:, 0], control[:-1]) * dilation[:-1, None] / intervals
    lacks, sizes = (jnp.max(jnp.abs(v), axis=1) for v in (slopes - expected, expected))
    same = lacks <= AGREEMENT * (1.0 + sizes)
    until = jnp.cumprod(same).astype(bool)[:, None, None]
    return jnp.where(until, found, jnp.inf)
