"""Integration by one kernel on an NVIDIA GPU, for float64.

In JAX every stage of every step is a few kernels: thousands of launches, one after the other, for one trajectory.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends import cuda, launch, libraries
from jaxscp.backends.codegen import functions, tracing
from jaxscp.backends.codegen.functions import TapedFunction
from jaxscp.backends.codegen.hoisted import hoisted_constants
from jaxscp.dynamics.base import Dynamics
from jaxscp.verification.integrator import cuda_source

LIBRARY = libraries.INTEGRATION  # launches the kernel
AGREEMENT = 1e-9  # relative difference of derivatives: far above rounding


@dataclass(frozen=True, eq=False)  # JAX refers weakly to a function that it traces, which a tuple forbids
class Kernel:
    """A compiled kernel, called with (start, control, dilation)."""

    dynamics: Dynamics
    derivative: TapedFunction
    """Of the state, by state and controls."""
    compiled: launch.Kernel
    samples: int
    """Points an interval."""

    def __call__(
        self, start: Float[Array, "n"], control: Float[Array, "nodes m"], dilation: Float[Array, "nodes"]
    ) -> Float[Array, "intervals samples n"]:
        """States at points of every interval.

        At the start of every interval the kernel's derivative is compared with the derivative by JAX. From the first
        disagreement on, the states are infinite.
        """
        intervals, n = dilation.shape[0] - 1, start.shape[0]
        w = jnp.concatenate([start, control.ravel(), dilation])[None]
        shapes = (1, intervals, self.samples, n), (1, intervals, n)
        constants = hoisted_constants(self.derivative)
        states, derivatives = (v[0] for v in self.compiled(w, constants, shapes=shapes))
        expected = (
            jax.vmap(lambda x, u: self.dynamics(x, u, 0.0))(states[:, 0], control[:-1])
            * dilation[:-1, None]
            / intervals
        )
        errors, sizes = (jnp.max(jnp.abs(v), axis=1) for v in (derivatives - expected, expected))
        agrees = errors <= AGREEMENT * (1.0 + sizes)
        until = jnp.cumprod(agrees).astype(bool)[:, None, None]
        return jnp.where(until, states, jnp.inf)

    def _rate(self, state: Float[Array, "n"], control: Float[Array, "m"]) -> Float[Array, "n"]:
        return self.dynamics(state, control, 0.0)


def kernel_for(
    dynamics: Dynamics, start: Float[Array, "n"], control: Float[Array, "nodes m"], samples: int
) -> Kernel | None:
    """The kernel for JAX's default device; None if it is no GPU or the dynamics have no kernel."""
    here = cuda.capability()
    if here is None or not launch.available(LIBRARY) or not libraries.in_float64((start, control)):
        return None
    try:
        derivative = record(dynamics)
    except tracing.CannotTrace:
        return None
    text = cuda_source.kernel(derivative, control.shape[0] - 1, samples)
    cubin = launch.cubin(text, here, "the verifier's integration")
    if cubin is None:
        return None
    compiled = launch.Kernel(LIBRARY.on_gpu, cubin, cuda_source.WARP, cuda_source.BLOCK_THREADS)
    return Kernel(dynamics, derivative, compiled, samples)


def record(dynamics: Dynamics) -> TapedFunction:
    """The derivative of the state as a tape, by state and controls.

    Raises:
        CannotTrace: if the dynamics are not arithmetic alone.
    """
    return functions.record(_Derivative(dynamics), dynamics.state_size + dynamics.control_size, (), order=0)


class _Derivative(eqx.Module):
    dynamics: Dynamics

    def __call__(self, a: Array) -> Array:
        n = self.dynamics.state_size
        return self.dynamics(a[:n], a[n:], 0.0)
