"""Which implementation serves: JAX, compiled C++, or a CUDA kernel. A slow one is never chosen in silence."""

import warnings

import equinox as eqx
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

    def names(self) -> dict[str, str]:
        """Name of each implementation; of a batch, of its first element, as all elements have the same."""
        return {part: BACKENDS[np.ravel(index)[0]] for part, index in vars(self).items()}

    def report(self) -> str:
        """One line for people."""
        return "integration: {integration}; conic step: {conic}".format(**self.names())


def index_of(name: str) -> Int[Array, ""]:
    """Index of an implementation into ``BACKENDS``."""
    return jnp.asarray(BACKENDS.index(name))


def warn_slow(message: str) -> None:
    """Warn of a slower implementation; Python prints the same message once."""
    warnings.warn(f"jaxscp: {message}", PerformanceWarning, stacklevel=3)
