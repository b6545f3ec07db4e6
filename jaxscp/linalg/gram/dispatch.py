"""Gram matrices for float64: in C++ on a CPU if compiled, in a kernel on an NVIDIA GPU; else in JAX.

XLA copies and transposes every Jacobian for small products; the others read each Jacobian once.
"""

from jaxscp.backends.libraries import dispatch, in_float64
from jaxscp.linalg.gram import in_jax, native
from jaxscp.linalg.gram.native import gpu
from jaxscp.linalg.gram.system import GramSums, WeightedRows


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """J' W J and J' v, summed over one constraint or more."""
    cpu = native.gram if in_float64(parts) and native.LIBRARY.available() else None
    return dispatch(cpu, in_jax.gram, parts, cuda=gpu.gram if gpu.supports(parts) else None)
