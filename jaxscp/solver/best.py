"""The best of many solutions."""

import jax
import jax.numpy as jnp

from jaxscp.core.status import Status
from jaxscp.solver.solution import Solution


def best(solutions: Solution) -> Solution:
    """The cheapest converged element of a batch; the first element if none converged: look at its status.

    ``argmin`` of the costs would choose an invalid element, whose cost is NaN.

    Args:
        solutions: with one leading axis.

    Example:
        >>> import jax, jax.numpy as jnp, jaxscp
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=3))
        >>> masses = jnp.array([0.9, jnp.nan])
        >>> def plan(mass):
        ...     import equinox as eqx
        ...     return planner(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass))
        >>> jaxscp.status_names(jaxscp.best(jax.vmap(plan)(masses)).status) != "invalid_input"
        True
    """
    cost = jnp.where(solutions.status == Status.converged, solutions.cost, jnp.inf)
    index = jnp.argmin(cost)
    return jax.tree.map(lambda v: v[index], solutions)
