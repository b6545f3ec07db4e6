"""The sums, on a CPU in float64 by C++ if that was compiled, and else as JAX.

XLA copies and transposes every Jacobian for products that are small; C++ reads each of them once for all.
"""

from jaxscp.backends.libraries import choose, in_float64
from jaxscp.linalg.gram import in_jax, native
from jaxscp.linalg.gram.system import GramSums, WeightedRows

__all__ = ["GramSums", "WeightedRows", "gram"]


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """Sums over all constraints, of which there must be one."""
    cpu = native.gram if in_float64(parts) and native.LIBRARY.available() else None
    return choose(cpu, in_jax.gram, parts)
