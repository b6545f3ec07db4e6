"""More starts: where the iterations from a guess find nothing, they start again from another guess or on another mesh.

A guess that is too quick for its path needs more thrust than there is. Or it turns more between two nodes than a
subproblem can tell. Most such problems are solved from the same path, flown more slowly. Others leave most of the
flight to a few long intervals, which fixed steps integrate badly: these are solved where no interval may be much longer
than the guess's. A solution may be an optimum but for the errors of its integration. It is then the next guess, and the
intervals that were too long are bounded (``mesh``).

In a long curved valley of the cost, the iterations may reach their limit on the way. Where no start leads to a
solution, they go on from there.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Count, Flag, Nodes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp import mesh
from jaxscp.transcription.layout import trajectory_of

FREE = jnp.inf
STARTS = (1.0, FREE), (1.5, FREE), (2.0, 4.0), (1.0, 4.0)
"""Of each planned start: time, and longest interval, in flight times and mean intervals of the guess."""
ATTEMPTS = 6  # planned starts, and those from solutions whose mesh is too coarse
AGAIN = (
    Status.dynamics_unmet,
    Status.constraints_unmet,
    Status.iteration_limit,
    Status.insufficient_progress,
    Status.numerical_error,
)
"""Ends that another start may cure."""


class Start(eqx.Module):
    """A guess, the greatest dilation of each of its nodes, and more; of several, along the leading axis."""

    z: Float[Array, "nodes variables"]
    most: Nodes
    keep_mesh: Flag
    """Whether the guess has a good mesh."""


class End(eqx.Module):
    """Of the iterations from a start."""

    state: Any
    """Last one of the method."""
    most: Nodes
    """Greatest dilations that held."""
    accurate: Nodes
    """Greatest dilations that its intervals need to be accurate; infinite where they are."""
    on_the_way: Flag
    """Whether more iterations may lead to a solution."""
    improves: Flag
    """Whether it may be the guess of a finer mesh: false after it led to nothing."""

    @property
    def coarse(self) -> Flag:
        """Whether it is a solution, but for the errors of its integration."""
        return (self.state.status == Status.converged) & jnp.any(jnp.isfinite(self.accurate))

    def as_start(self) -> Start:
        """Its last point, on a mesh that is fine enough."""
        most, z = jnp.minimum(self.most, self.accurate), self.state.z
        return Start(z.at[:, -1].min(most), most, jnp.zeros((), bool))

    @property
    def failed(self) -> Flag:
        """Whether it is no solution, and another start may find one."""
        return jnp.any(jnp.stack([self.state.status == status for status in AGAIN]))


def restarted(
    method: Any,
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    enabled: Flag,
    keep_mesh: Flag,
) -> tuple[Any, Nodes]:
    """Last state of a method from a guess, or from the first start that leads to a solution; and its mesh's bounds.

    Args:
        method: whose ``run`` is meant. Without a grid, it starts on no other mesh.
        problem: without derivatives.
        z: the guess.
        enabled: whether steps are taken at all.
        keep_mesh: whether the guess has a good mesh; the other starts have none.
    """
    starts = _planned(method, problem, z, keep_mesh)
    arrays, rest = eqx.partition(problem, eqx.is_array)

    @jax.jit  # traced once
    def run(arrays, start: Start, enabled: Flag) -> End:
        return _run(method, eqx.combine(arrays, rest), start, enabled)

    def from_start(fixed, _, needed: Flag) -> End:
        arrays, start, enabled = fixed
        return run(arrays, start, enabled & needed)

    first = jax.tree.map(lambda v: v[0], starts)
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(run, arrays, first, enabled).state)

    def attempt(carry: tuple[End, Count], _):
        last, used = carry
        refine, go_on = last.coarse & last.improves, last.on_the_way & (used == starts.z.shape[0])
        none_yet, left = used == 0, used < starts.z.shape[0]
        planned = jax.tree.map(lambda v: v[jnp.minimum(used, v.shape[0] - 1)], starts)
        another = left & ~_same(problem, planned, first) & (last.coarse | last.failed)
        needed = none_yet | (enabled & (refine | another | go_on))
        start = tree_where(refine | go_on, last.as_start(), planned)
        found = batching.where_needed(
            needed, from_start, (arrays, start, enabled), last, batching.CHUNK_AROUND_LOOPS
        )
        taken = none_yet | (found.state.status == Status.converged)
        last = dataclasses.replace(last, improves=last.improves & ~(needed & refine))
        return (tree_where(taken, found, last), used + (~refine).astype(int)), None

    no = jnp.zeros((), bool)
    begun = End(nothing, first.most, first.most, no, no), jnp.zeros((), int)
    (end, _), _ = jax.lax.scan(attempt, begun, length=ATTEMPTS)
    return end.state, end.most


def _run(method: Any, problem: ScaledTimeProblem, start: Start, enabled: Flag) -> End:
    """The iterations from a start."""
    stated = mesh.bounded(problem, start.most)
    state = method.run(stated, start.z, enabled, start.keep_mesh)
    accurate = FREE if method.grid is None else mesh.bounds(stated, state.z, method.grid)
    accurate, yes = jnp.full_like(start.most, accurate), jnp.ones((), bool)
    return End(state, start.most, accurate, jnp.asarray(method.on_the_way(state)), yes)


def slower(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], factor: float
) -> Float[Array, "nodes variables"]:
    """The guess in a factor times its time, as far as the problem allows."""
    plan = trajectory_of(problem, z)
    dilation = jnp.clip(factor * plan.dilation, problem.dilation_min, problem.dilation_max)
    return problem.join(plan.state, plan.control, jnp.maximum(dilation, plan.dilation))


def _planned(
    method: Any, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], keep_mesh: Flag
) -> Start:
    """The planned starts, in their order; the first one is the guess as it is."""
    mean, starts = jnp.mean(z[:, -1]), []
    for time, longest in STARTS:
        if longest == FREE or method.grid is not None:
            guess = z if time == 1.0 else slower(problem, z, time)
            keeps = keep_mesh & jnp.asarray(not starts)
            starts.append(Start(guess, jnp.full(z.shape[0], longest * mean), keeps))
    return jax.tree.map(lambda *v: jnp.stack(v), *starts)


def _same(problem: ScaledTimeProblem, a: Start, b: Start) -> Flag:
    """Whether two starts are one, because the problem allows no other times."""
    limits = [jnp.broadcast_to(mesh.bounded(problem, s.most).dilation_max, s.most.shape) for s in (a, b)]
    return jnp.all(a.z == b.z) & jnp.all(limits[0] == limits[1])
