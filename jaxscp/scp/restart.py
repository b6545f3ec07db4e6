"""A second start: where the iterations from a guess find nothing, they start once more from a slower one.

A guess that is too quick for its path needs more thrust than there is. Or it turns more between two nodes than a
subproblem can tell. Most such problems are solved from the same path, flown more slowly.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.core.types import Flag
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.layout import trajectory_of

SLOWER = 1.5  # times the guess's flight time
AGAIN = (
    Status.dynamics_unmet,
    Status.constraints_unmet,
    Status.iteration_limit,
    Status.insufficient_progress,
    Status.numerical_error,
)
"""Ends that another guess may cure."""


def restarted(
    method: Any, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], enabled: Flag
) -> Any:
    """Last state of a method from a guess, or from a slower one if only that converges.

    Args:
        method: whose ``run`` is meant.
        problem: without derivatives.
        z: the guess.
        enabled: whether steps are taken at all.
    """
    slow = slower(problem, z)
    arrays, rest = eqx.partition(problem, eqx.is_array)
    run = jax.jit(lambda arrays, z, enabled: method.run(eqx.combine(arrays, rest), z, enabled))  # traced once
    zero = lambda v: jnp.zeros(v.shape, v.dtype)  # noqa: E731
    none = jax.tree.map(zero, jax.eval_shape(run, arrays, z, enabled))

    def attempt(last, start):
        guess, first = start
        failed = jnp.any(jnp.stack([last.status == status for status in AGAIN]))
        needed = first | (enabled & failed & jnp.any(slow != z))
        found = batching.where_needed(needed, lambda fixed, _: run(*fixed), (arrays, guess, enabled), last)
        taken = first | (found.status == Status.converged)
        return jax.tree.map(lambda a, b: jnp.where(taken, a, b), found, last), None

    end, _ = jax.lax.scan(attempt, none, (jnp.stack([z, slow]), jnp.array([True, False])))
    return end


def slower(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]) -> Float[Array, "nodes variables"]:
    """The guess in more time, as far as the problem allows."""
    plan = trajectory_of(problem, z)
    dilation = jnp.clip(SLOWER * plan.dilation, problem.dilation_min, problem.dilation_max)
    return problem.join(plan.state, plan.control, jnp.maximum(dilation, plan.dilation))
