"""How much of a step to take: the longest part that, corrected, is good enough.

A part that is shorter, and its correction, are far cheaper than another subproblem; but most whole steps are good, so
that parts are tried one after the other.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem, terminal_cost
from jaxscp.scp.second_order_correction import Correction, corrected
from jaxscp.transcription.lagrangian import Residual, merit, residual
from jaxscp.transcription.shooting import Grid, evaluate

LENGTHS = (1.0, 0.5, 0.2)  # parts of a step that are tried


class Merit(eqx.Module):
    """The augmented Lagrangian that judges points."""

    problem: OptimalControlProblem
    multipliers: Multipliers
    weight: float
    scale: Float[Array, "states"]

    def __call__(self, r: Residual) -> Scalar:
        """Of a point, by its residual."""
        return merit(self.problem, r, self.multipliers, self.weight, self.scale)


class Step(eqx.Module):
    """A step from a reference, and what its parts are judged by."""

    z: Float[Array, "nodes variables"]
    """The reference."""
    move: Float[Array, "nodes variables"]
    """The whole step."""
    room: Float[Array, "intervals conditions"]
    """The reference's slacks."""
    correction: Correction
    merit: Merit
    enough: Scalar
    """Merit that is good enough."""
    grid: Grid
    rounds: int = eqx.field(static=True)
    """Of the correction."""


class Trial(eqx.Module):
    """A part of the step, corrected."""

    z: Float[Array, "nodes variables"]
    residual: Residual
    merit: Scalar
    """Infinite where it is no number."""


class Search(eqx.Module):
    """State of the loop, and what it ends with."""

    whole: Trial
    last: Trial
    tried: Count
    good: Flag
    """Whether the last one is good enough."""

    @property
    def chosen(self) -> Count:
        """Which of ``LENGTHS``: the longest that is good enough, or the whole step if none is."""
        return jnp.where(self.good, self.tried - 1, 0)

    @property
    def trial(self) -> Trial:
        """What came of that."""
        return jax.tree.map(lambda a, b: jnp.where(self.good, a, b), self.last, self.whole)


def search(step: Step, now: Residual) -> Search:
    """Try parts of a step, from the longest to the shortest.

    Args:
        step: to be tried.
        now: residual of the reference.
    """
    blank = jax.tree.map(jnp.zeros_like, Trial(step.z, now, step.enough))
    start = Search(blank, blank, jnp.zeros((), int), jnp.zeros((), bool))
    return batching.while_loop(lambda s: ~s.good & (s.tried < len(LENGTHS)), _try_next, step, start)


def _try_next(step: Step, s: Search) -> Search:
    new = attempt(step, jnp.asarray(LENGTHS, step.z.dtype)[s.tried])
    whole = jax.tree.map(lambda a, b: jnp.where(s.tried == 0, a, b), new, s.whole)
    return Search(whole, new, s.tried + 1, new.merit <= step.enough)


def attempt(step: Step, length: Scalar | float) -> Trial:
    """A part of the step, corrected."""
    problem = step.merit.problem
    z, rest = step.z + length * step.move, (1.0 - length) * step.room
    z = corrected(problem, z, step.correction, step.grid, step.rounds, rest)
    found = residual(evaluate(problem, z, step.grid), terminal_cost(problem, z), z)
    return Trial(z, found, jnp.nan_to_num(step.merit(found), nan=jnp.inf))
