"""A problem of the user's, in typical sizes that are measured on a trajectory; and its solution in sizes of its own.

Barrier, tolerances and the certificate all follow the sizes. A guess that is far off, or a large limit that stands for
none, tells sizes that are far from the solution's. So these are measured again at the solution. Where they differ by
much, the problem is solved again from there. The certificate judges by the solution's own sizes.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Count, Flag, Nodes
from jaxscp.problem.form import Form
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scale import Scale
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.problem.usual_scale import far, usual_scale
from jaxscp.scp import mesh
from jaxscp.scp.method import Method, MethodResult
from jaxscp.scp.restart import restarted
from jaxscp.transcription.layout import trajectory_of

ROUNDS = 6  # first the states' sizes become right, then the controls', then the cost's


class Sized(eqx.Module):
    """A problem, and the trajectory on which its sizes are measured."""

    stated: OptimalControlProblem
    """Of ``canonical``."""
    trajectory: Trajectory
    scale: Scale
    form: Form

    @classmethod
    def on(cls, stated: OptimalControlProblem, guess: Trajectory, form: Form) -> "Sized":
        """Sizes at a guess."""
        scale = usual_scale(stated, guess) if stated.scale is None else stated.scale
        fields = guess.time, guess.state, guess.control, guess.dilation
        return cls(stated, Trajectory(*fields, stated.zero_order_hold), scale, form)

    def at(self, plan: Trajectory) -> "Sized":
        """Sizes at a better trajectory."""
        stated = self.stated
        scale = usual_scale(stated, plan, self.scale) if stated.scale is None else stated.scale
        return Sized(stated, plan, scale, self.form)

    def problem(self) -> ScaledTimeProblem:
        """The problem over scaled time; its sizes have no derivatives."""
        stated = eqx.tree_at(lambda p: p.scale, self.stated, self.scale, is_leaf=lambda v: v is None)
        return over_scaled_time(stated, self.form, jax.lax.stop_gradient(self.trajectory))


class _Round(eqx.Module):
    """The best end so far, and what comes next."""

    state: Any
    """Of the method."""
    most: Nodes
    """Bounds of its mesh."""
    sized: tuple[Trajectory, Scale]
    """Sizes that it was found in."""
    following: tuple[Trajectory, Scale]
    """Sizes to go on in."""
    count: Count
    failed: Flag
    """Whether the last attempt found nothing, after one that had."""
    unfinished: Flag


def iterate_sized(
    method: Method, sized: Sized, enabled: Flag, keep_mesh: Flag
) -> tuple[MethodResult, ScaledTimeProblem, Sized]:
    """Result of a method from the trajectory of ``sized``, and the problem and the sizes that it was found in.

    Derivatives bypass the iterations.
    """
    frozen = jax.lax.stop_gradient((sized, jnp.asarray(enabled), jnp.asarray(keep_mesh)))
    end = batching.alone_on_a_cpu(lambda fixed: _rounds(method, *fixed), frozen)
    trajectory, scale = jax.lax.stop_gradient(end.sized)
    found = Sized(sized.stated, trajectory, scale, sized.form)
    problem = found.problem()
    return method.result(mesh.bounded(problem, end.most), end.state), problem, found


def _rounds(method: Method, sized: Sized, enabled: Flag, keep_mesh: Flag) -> _Round:
    def step(fixed: tuple[Sized, Flag, Flag], last: _Round) -> _Round:
        sized, enabled, keep_mesh = fixed
        return _round(method, Sized(sized.stated, *last.following, sized.form), enabled, keep_mesh, last)

    first, no = (sized.trajectory, sized.scale), jnp.zeros((), bool)
    ends = jax.eval_shape(lambda: _attempt(method, sized, enabled, keep_mesh))
    state, most = jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), ends)
    start = _Round(state, most, first, first, jnp.zeros((), int), no, ~no)
    fixed = (sized, enabled, keep_mesh)
    return batching.while_loop(lambda s: s.unfinished, step, fixed, start, batching.CHUNK_AROUND_LOOPS)


def _attempt(method: Method, sized: Sized, enabled: Flag, keep_mesh: Flag) -> tuple[Any, Nodes]:
    problem, guess = sized.problem(), sized.trajectory
    z = problem.join(guess.state, guess.control, guess.dilation)
    return restarted(method, problem, z, enabled, keep_mesh)


def _round(method: Method, sized: Sized, enabled: Flag, keep_mesh: Flag, last: _Round) -> _Round:
    """One solution, and whether the sizes there differ from those that it was found in."""
    state, most = _attempt(method, sized, enabled, keep_mesh)
    problem = sized.problem()
    plan = trajectory_of(problem, state.z)
    following = sized.at(plan)
    converged = state.status == Status.converged
    taken = (last.count == 0) | converged | (last.state.status != Status.converged)
    finite = jnp.all(jnp.isfinite(plan.state)) & jnp.all(jnp.isfinite(plan.control))
    differs = _sizes_differ(problem, following.problem())
    now = (sized.trajectory, sized.scale)
    count = last.count + 1
    return _Round(
        state=tree_where(taken, state, last.state),
        most=jnp.where(taken, most, last.most),
        sized=tree_where(taken, now, last.sized),
        following=(following.trajectory, following.scale),
        count=count,
        failed=~taken,
        # a solution in wrong sizes may be a bad guess, from which the right ones lead only half the way
        unfinished=enabled & finite & (count < ROUNDS) & jnp.where(taken, differs, ~last.failed),
    )


def _sizes_differ(problem: ScaledTimeProblem, other: ScaledTimeProblem) -> Flag:
    """Whether a size of one is far from that of the other."""

    def sizes(p: ScaledTimeProblem) -> list[Array]:
        return jax.tree.leaves((p.sizes, [c.size for c in (*p.constraints, *p.checks)]))

    pairs = zip(sizes(problem), sizes(other), strict=True)
    return jnp.any(jnp.stack([far(now, then) for now, then in pairs]))
