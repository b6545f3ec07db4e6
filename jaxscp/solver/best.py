"""The best of many solutions."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.backends.xla import is_traced
from jaxscp.core.implicit import undefined_unless
from jaxscp.core.status import Status, status_names
from jaxscp.solver.solution import Solution


def best(solutions: Solution | Sequence[Solution]) -> Solution:
    """The cheapest converged solution.

    ``argmin`` of the costs would choose an invalid element, whose cost is NaN. Inside ``jit`` nothing can raise: if
    none converged there, the result has the status of the first one, and NaN in every float.

    Args:
        solutions: a batch with one leading axis, or a sequence of single solutions of one shape.

    Raises:
        ValueError: there is no solution, none converged, or a batch has another number of axes.

    Example:
        >>> import equinox as eqx, jax.numpy as jnp, jaxscp
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> planner = jaxscp.Planner(nodes=20)
        >>> def plan(mass):
        ...     return planner(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, jnp.array(mass)))
        >>> plans = [plan(1.0), plan(0.9)]
        >>> bool(jaxscp.best(plans).cost == plans[1].cost)
        True
    """
    batch = solutions if isinstance(solutions, Solution) else _stacked(solutions)
    if (axes := batch.cost.ndim) != 1:
        raise ValueError(f"solutions: expected one leading axis, got {axes}; put single solutions in a list.")
    converged = batch.status == Status.converged
    some = jnp.any(converged)
    if not is_traced(some) and not some:
        raise ValueError(
            f"solutions: none of {len(batch.cost)} converged: {_counts(batch)}. Print one for its cause."
        )
    index = jnp.argmin(jnp.where(converged, batch.cost, jnp.inf))
    chosen = jax.tree.map(lambda v: v[index], batch)
    if not is_traced(some):
        return chosen
    floats, rest = eqx.partition(chosen, eqx.is_inexact_array)
    return eqx.combine(undefined_unless(some, floats), rest)


def _counts(batch: Solution) -> str:
    names, counts = np.unique(status_names(batch.status), return_counts=True)
    return ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))


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
