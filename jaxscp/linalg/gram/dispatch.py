"""Gram matrices: in C++ for float64 on a CPU if compiled, else in JAX.

XLA copies and transposes every Jacobian for small products; the C++ reads each Jacobian once.
"""

from jaxscp.backends.libraries import dispatch, in_float64
from jaxscp.linalg.gram import in_jax, native
from jaxscp.linalg.gram.system import GramSums, WeightedRows


def gram(parts: tuple[WeightedRows, ...]) -> GramSums:
    """J' W J and J' v, summed over one constraint or more."""
    cpu = native.gram if in_float64(parts) and native.LIBRARY.available() else None
    return dispatch(cpu, in_jax.gram, parts)
