"""A re-plan is never worse than a plan: where the earlier plan does not lead to a solution, one is made anew."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from jaxscp.backends.xla import is_traced
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Flag
from jaxscp.solver.solution import Solution


def better(found: Solution, alternative: Callable[[Flag], Solution]) -> Solution:
    """The solution found, if it converged or another one does not converge either; else the other one.

    Args:
        found: by a re-plan.
        alternative: makes the other one where the argument is true.
    """
    needed = (found.status != Status.converged) & (found.status != Status.invalid_input)
    if not is_traced(found) and not bool(jnp.any(needed)):
        return found
    other = alternative(needed)
    other = eqx.tree_at(lambda s: s.fell_back, other, jnp.ones((), bool))
    taken = needed & (other.status == Status.converged)
    return tree_where(taken, other, found)
