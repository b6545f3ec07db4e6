"""History of the iterations."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.core.types import Count


class History(eqx.Module):
    """One row an iteration, (max_iterations,) each; rows from ``iterations`` on are zero."""

    cost: Float[Array, "*iterations"]
    """Cost of the iterate; in ``PTR``, as its subproblem predicts it."""
    objective: Float[Array, "*iterations"]
    """Optimal value of the subproblem, with penalties and without constants."""
    final_time: Float[Array, "*iterations"]
    """Seconds."""
    virtual_control: Float[Array, "*iterations"]
    """Largest virtual control of an interval, max |nu_i|."""
    step_norm: Float[Array, "*iterations"]
    """Largest change of a node, max |z_k - zref_k|."""
    defect: Float[Array, "*iterations"]
    """Largest residual of the dynamics over an interval, |F(z_i) - x_{i+1}|."""
    conic_iterations: Int[Array, "*iterations"]
    """Steps of the conic solver."""

    @classmethod
    def zeros(cls, iterations: int, dtype) -> "History":
        """Empty rows for that many iterations."""
        zeros, counts = jnp.zeros(iterations, dtype), jnp.zeros(iterations, int)
        return cls(zeros, zeros, zeros, zeros, zeros, zeros, counts)

    def with_row(self, index: Count, row: "History") -> "History":
        """The history with one row set."""
        return jax.tree.map(lambda h, v: h.at[index].set(v), self, row)
