"""Which implementation serves: JAX, compiled C++, or a CUDA kernel. A slow one is never chosen in silence."""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

BACKENDS = "JAX", "C++", "CUDA", "OSQP", "other"


class PerformanceWarning(UserWarning):
    """Something slower than usual serves; the message says what, and the remedy."""


class Backends(eqx.Module):
    """Implementations that made a solution, as indices into ``BACKENDS``.

    They are arrays, because a program is compiled for a CPU and a GPU alike, and only then knows which one it runs on.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxscp
        >>> print(jaxscp.Backends(integration=jnp.array(1), conic=jnp.array(0)).report())
        integration: C++; conic step: JAX
    """

    integration: Int[Array, "*batch"]
    """Of the intervals and their derivatives. JAX serves a function with an operation that C++ lacks."""
    conic: Int[Array, "*batch"]
    """Of the subproblems."""

    def report(self) -> str:
        """One line for people; of a batch, the first element, as all elements have the same."""
        integration, conic = (BACKENDS[np.ravel(code)[0]] for code in (self.integration, self.conic))
        return f"integration: {integration}; conic step: {conic}"


def serving(*, cpp: bool, cuda: bool) -> Int[Array, ""]:
    """Index of the implementation for the device that runs the program, as ``libraries.dispatch`` chooses it.

    Args:
        cpp: whether there is compiled C++, for a CPU.
        cuda: whether there is a kernel, for an NVIDIA GPU.
    """
    code = lambda name: jnp.asarray(BACKENDS.index(name))  # noqa: E731
    if cpp and jax.default_backend() == "cpu":
        return code("C++")
    compiled = {}
    if cpp:
        compiled["cpu"] = lambda: code("C++")
    if cuda:
        compiled["cuda"] = lambda: code("CUDA")
    return jax.lax.platform_dependent(default=lambda: code("JAX"), **compiled) if compiled else code("JAX")


def warn_slow(message: str) -> None:
    """Warn of a slower implementation; Python prints the same message once."""
    warnings.warn(f"jaxscp: {message}", PerformanceWarning, stacklevel=3)
