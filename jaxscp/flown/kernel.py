"""The flight as one kernel of an NVIDIA GPU, for float64.

As JAX, every stage of every step is a few kernels, thousands one after another for a flight.
"""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp import libraries
from jaxscp.dynamics import Dynamics
from jaxscp.flown import source
from jaxscp.libraries import cuda
from jaxscp.sweeps import functions, tracing
from jaxscp.sweeps.functions import Function
from jaxscp.sweeps.kernel import known_of, launched


def flight(
    dynamics: Dynamics, start: Float[Array, "n"], control: Float[Array, "nodes m"], samples: int
) -> Callable[..., Any] | None:
    """What flies, as a function of (start, control, dilation), on JAX's default device; None where that is no GPU or
    has no kernel for it."""
    here = cuda.capability()
    if here is None or not (cuda.launches(libraries.SWEEP) and cuda.compiles_for(here)):
        return None
    if not libraries.in_float64((start, control)):
        return None
    try:
        slope = record(dynamics)
    except tracing.CannotTrace:
        return None
    image = machine_code(source.kernel(slope, control.shape[0] - 1, samples), here)
    return None if image is None else functools.partial(states, slope, image, source.LANES, samples)


def record(dynamics: Dynamics) -> Function:
    """The slope of the state, as a function of the state and the controls.

    Raises:
        CannotTrace: if it is not arithmetic alone.
    """
    n = dynamics.state_size
    return functions.record(lambda a: dynamics(a[:n], a[n:]), n + dynamics.control_size, (), order=0)


@functools.cache
def machine_code(text: str, capability: str) -> bytes | None:
    """A kernel as machine code of the GPU; None and a warning if it does not compile."""
    try:
        return cuda.machine_code(text, capability)
    except RuntimeError as error:
        warnings.warn(f"{error}; flights run as JAX", stacklevel=2)
        return None


def states(
    slope: Function,
    image: bytes,
    lanes: int,
    samples: int,
    start: Float[Array, "n"],
    control: Float[Array, "nodes m"],
    dilation: Float[Array, "nodes"],
) -> Float[Array, "intervals samples n"]:
    """States at points of every interval, by a kernel of which so many lanes fly together."""
    w = jnp.concatenate([start, control.ravel(), dilation])[None]
    shape = (dilation.shape[0] - 1, samples, start.shape[0])
    found, _ = launched(image, w, known_of(slope), ((1, *shape), (1, 1)), lanes, source.THREADS)
    return found[0]
