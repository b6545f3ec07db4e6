"""Line search: the longest fraction of a step whose corrected point decreases the merit enough.

A shorter fraction, with its correction, is far cheaper than another subproblem. Most whole steps are good, so that
fractions are tried one after the other.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.active_set import active_set, slacks
from jaxscp.scp.convex_model import ConvexModel
from jaxscp.scp.second_order_correction import Correction, Target, corrected, correction
from jaxscp.scp.state import NewtonSettings, NewtonState
from jaxscp.scp.subproblem import SubproblemSolution
from jaxscp.transcription.lagrangian import Merit, Residual, residual
from jaxscp.transcription.shooting import Grid, evaluate

LENGTHS = (1.0, 0.5, 0.2)  # fractions of a step, in the order of the trials
PROXIMAL_GROWTH = (1.0, 2.0, 4.0)  # least growth of the proximal weight, for each of the fractions
SUFFICIENT_DECREASE = 1e-4  # fraction of the predicted decrease


class Search(eqx.Module):
    """A step from a reference, with the data that its trials share."""

    z: Float[Array, "nodes variables"]
    """The reference."""
    step: Float[Array, "nodes variables"]
    """The whole step."""
    reference: Target
    """Slacks and end residuals of the reference."""
    correction: Correction
    merit: Merit
    sufficient: Scalar
    """Merit that a trial must not exceed."""
    grid: Grid
    rounds: int = eqx.field(static=True)
    """Of the correction."""


class Trial(eqx.Module):
    """A fraction of the step, corrected."""

    z: Float[Array, "nodes variables"]
    residual: Residual
    merit: Scalar
    """Infinite where the merit is not a number."""


class LineSearch(eqx.Module):
    """State of the search, and its result."""

    whole: Trial
    """The whole step."""
    last: Trial
    tried: Count
    sufficient: Flag
    """Whether the last trial decreases the merit enough."""

    @property
    def chosen(self) -> Count:
        """Index in ``LENGTHS`` of the longest sufficient fraction; zero, the whole step, if there is none."""
        return jnp.where(self.sufficient, self.tried - 1, 0)

    @property
    def trial(self) -> Trial:
        """The chosen trial."""
        return tree_where(self.sufficient, self.last, self.whole)


def line_search(
    settings: NewtonSettings,
    problem: ScaledTimeProblem,
    state: NewtonState,
    model: ConvexModel,
    qp: SubproblemSolution,
) -> LineSearch:
    """Try fractions of the subproblem's step, from the longest to the shortest, against the merit history."""
    now = state.residual
    active = active_set(problem, state.linear, qp.multipliers, model.scale)
    worst = jnp.max(jax.vmap(qp.merit)(state.merit_history))
    search = Search(
        z=state.z,
        step=qp.step,
        reference=Target(slacks(problem, state.linear.outputs), now.initial, now.final),
        correction=correction(problem, state.linear, active, model.metric, state.scale),
        merit=qp.merit,
        # the prediction may be of either sign: the model's Hessian is not the one that predicts
        sufficient=worst - SUFFICIENT_DECREASE * jnp.abs(qp.decrease),
        grid=settings.grid,
        rounds=settings.correction_rounds,
    )
    blank = jax.tree.map(jnp.zeros_like, Trial(search.z, now, search.sufficient))
    start = LineSearch(blank, blank, jnp.zeros((), int), jnp.zeros((), bool))
    unfinished = lambda s: ~s.sufficient & (s.tried < len(LENGTHS))  # noqa: E731
    return batching.while_loop(unfinished, _try_next, search, start)


def _try_next(search: Search, s: LineSearch) -> LineSearch:
    new = _attempt(search, jnp.asarray(LENGTHS, search.z.dtype)[s.tried])
    whole = tree_where(s.tried == 0, new, s.whole)
    return LineSearch(whole, new, s.tried + 1, new.merit <= search.sufficient)


def _attempt(search: Search, length: Scalar | float) -> Trial:
    """A fraction of the step, corrected."""
    problem = search.merit.problem
    target = jax.tree.map(lambda v: (1.0 - length) * v, search.reference)
    z = search.z + length * search.step
    z = corrected(problem, z, search.correction, search.grid, search.rounds, target)
    found = residual(problem, z, evaluate(problem, z, search.grid))
    return Trial(z, found, jnp.nan_to_num(search.merit(found), nan=jnp.inf))
