"""The best of many solutions."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jaxscp.core.status import Status
from jaxscp.solver.solution import Solution


def best(solutions: Solution | Sequence[Solution]) -> Solution:
    """The cheapest converged solution; the first one if none converged: look at its status.

    ``argmin`` of the costs would choose an invalid element, whose cost is NaN.

    Args:
        solutions: a batch with one leading axis, or a sequence of single solutions of one shape.

    Raises:
        ValueError: there is no solution, or a batch has another number of axes.

    Example:
        >>> import equinox as eqx, jax, jax.numpy as jnp, jaxscp
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=3))
        >>> def plan(mass):
        ...     return planner(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass))
        >>> plans = jax.vmap(plan)(jnp.array([0.9, jnp.nan]))
        >>> jaxscp.status_names(jaxscp.best(plans).status) != "invalid_input"
        True
    """
    batch = solutions if isinstance(solutions, Solution) else _stacked(solutions)
    if (axes := batch.cost.ndim) != 1:
        raise ValueError(f"solutions: expected one leading axis, got {axes}; put single solutions in a list.")
    cost = jnp.where(batch.status == Status.converged, batch.cost, jnp.inf)
    index = jnp.argmin(cost)
    return jax.tree.map(lambda v: v[index], batch)


def _stacked(solutions: Sequence[Solution]) -> Solution:
    if not isinstance(solutions, Sequence) or not all(isinstance(one, Solution) for one in solutions):
        raise ValueError(f"solutions: expected solutions, got {solutions!r:.80}.")
    if not solutions:
        raise ValueError("solutions: expected single solutions in a sequence, got none.")
    axes = {solution.cost.ndim for solution in solutions}
    if axes != {0}:
        raise ValueError(
            f"solutions: expected single solutions in a sequence, got {sorted(axes)} leading axes."
        )
    return jax.tree.map(lambda *v: jnp.stack(v), *solutions)
