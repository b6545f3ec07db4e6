"""How the iterations of a plan went."""

import equinox as eqx
from jaxtyping import Array, Float, Int


class History(eqx.Module):
    """One row an iteration, (max_iterations,) each; rows from ``iterations`` on are zero."""

    cost: Float[Array, "*iterations"]
    """The problem's cost at the iterate, as its subproblem predicts it."""
    objective: Float[Array, "*iterations"]
    """Optimal value of the subproblem, penalties included and constants left out."""
    final_time: Float[Array, "*iterations"]
    """Seconds."""
    virtual: Float[Array, "*iterations"]
    """Largest virtual control of an interval, max |nu_i|."""
    step: Float[Array, "*iterations"]
    """Largest change of a node, max |z_k - zref_k|."""
    defect: Float[Array, "*iterations"]
    """Largest |F(z_i) - x_{i+1}| of an interval: what the iterate lacks of obeying the true dynamics."""
    conic_iterations: Int[Array, "*iterations"]
    """Steps of the conic solver."""
