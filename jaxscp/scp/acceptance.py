"""Acceptance of a step, and the proximal weight of the next: it follows the ratio of actual and predicted decrease."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from jaxscp.core.status import usable
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.line_search import PROXIMAL_GROWTH, LineSearch
from jaxscp.scp.state import NewtonSettings, NewtonState
from jaxscp.scp.subproblem import SubproblemSolution
from jaxscp.transcription.shooting import linearise_with_hessian

FULL_HESSIAN_BELOW = 1e-3  # proximal weight below which the Hessian is convexified along the horizon
FULL_HESSIAN_PROXIMAL = 0.02  # proximal weight to begin that with
LEAST_PROXIMAL, MOST_PROXIMAL = 1e-5, 1e4


def accept_or_reject(
    settings: NewtonSettings,
    problem: ScaledTimeProblem,
    state: NewtonState,
    qp: SubproblemSolution,
    search: LineSearch,
) -> NewtonState:
    """The state after the step: linearised anew if the step is accepted, else with a larger proximal weight."""
    trial = search.trial
    # Before the choice: the new linearisation must be finite too.
    linear, hessian = linearise_with_hessian(problem, trial.z, qp.multipliers, settings.grid)
    actual = qp.merit(state.residual) - search.whole.merit
    ratio = jnp.where(qp.decrease_negligible, 1.0, actual / jnp.maximum(jnp.abs(qp.decrease), 1e-12))
    flat, _ = ravel_pytree((trial.residual, linear, hessian, qp.multipliers))
    good = usable(qp.conic.status) & jnp.all(jnp.isfinite(flat))
    accept = good & (search.sufficient | qp.decrease_negligible)

    proximal, full_hessian = _next_proximal(state, ratio, accept, search.chosen)
    merit_history = jax.tree.map(
        lambda old, v: jnp.concatenate([v[None], old[:-1]]), state.merit_history, trial.residual
    )
    choice = lambda s: (s.z, s.merit_history, s.linear, s.hessian, s.multipliers, s.conic_multipliers)  # noqa: E731
    chosen = jax.lax.cond(
        accept,
        lambda taken, _: taken,
        lambda _, before: before,
        (trial.z, merit_history, linear, hessian, qp.multipliers, qp.conic.multipliers),
        choice(state),
    )
    new = eqx.tree_at(choice, state, chosen)
    return eqx.tree_at(
        lambda s: (s.proximal, s.full_hessian, s.scale, s.accepted_with_small_proximal),
        new,
        (
            proximal,
            full_hessian,
            jnp.maximum(state.scale, typical_sizes(new.z)),
            accept & (state.proximal <= FULL_HESSIAN_PROXIMAL),
        ),
    )


def _next_proximal(state: NewtonState, ratio: Scalar, accept: Flag, chosen: Count):
    """Next proximal weight, and whether the Hessian is convexified along the horizon.

    Args:
        state: before the step.
        ratio: of actual and predicted decrease of the whole step.
        accept: whether any fraction of the step was taken.
        chosen: index of that fraction.
    """
    blockwise = jnp.where(ratio > 0.5, 0.2, jnp.where(ratio > 0.1, 1.0, 2.0))
    full = jnp.where(ratio > 0.85, 0.2, jnp.where(ratio > 0.6, 0.5, jnp.where(ratio > 0.2, 1.0, 3.0)))
    factor = jnp.where(state.full_hessian, full, blockwise)
    factor = jnp.where(chosen > 0, jnp.maximum(factor, jnp.array(PROXIMAL_GROWTH)[chosen]), factor)
    factor = jnp.where(accept, factor, jnp.where(state.full_hessian, 5.0, 8.0))
    proximal = jnp.maximum(state.proximal * factor, LEAST_PROXIMAL)
    begin = accept & ~state.full_hessian & (proximal < FULL_HESSIAN_BELOW) & (ratio > 0.5)
    return jnp.where(begin, FULL_HESSIAN_PROXIMAL, proximal), state.full_hessian | begin
