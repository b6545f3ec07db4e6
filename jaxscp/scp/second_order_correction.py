"""Second-order correction: take back what a step lacks because the dynamics curve, not by a subproblem but by
linear algebra.

Rounds of a chord method: the residuals are those of the candidate, the Jacobians those of the reference, and the
answer is the least one in a metric, with the active constraints held. All rounds share one factorisation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.linalg import riccati
from jaxscp.problem.problem import OptimalControlProblem, end_condition
from jaxscp.scp.active_set import ActiveSet, slacks
from jaxscp.transcription.layout import onto_nodes
from jaxscp.transcription.shooting import Grid, Linearisation, evaluate

HOLD = (
    300.0  # usual price of leaving an active constraint, in scaled units: far above the curvature of the rest
)
_DAMPING = 1e-2  # keeps the metric positive definite


class Correction(eqx.Module):
    """What corrections of steps from one reference share."""

    factor: riccati.Factor
    """Of the least step's conditions, in scaled variables."""
    active: ActiveSet
    """Constraints that are held."""
    hold: Scalar
    """Price of leaving them."""
    scale: Float[Array, "variables"]
    """Typical sizes."""


def correction(
    problem: OptimalControlProblem,
    linear: Linearisation,
    active: ActiveSet,
    metric: Float[Array, "intervals inputs inputs"],
    scale: Float[Array, "variables"],
    hold: Scalar | float = HOLD,
) -> Correction:
    """Factor the conditions of a least step.

    Args:
        problem: gives the sizes.
        linear: the reference.
        active: constraints that the step ended on.
        metric: convex curvature in scaled units; a correction is least in it.
        scale: typical sizes of a node's variables.
        hold: price of leaving an active constraint, in scaled units.
    """
    n, stage = problem.state_size, problem.variables
    sizes = jnp.concatenate([scale, scale[n:]])
    damping = _DAMPING * jnp.eye(sizes.shape[0], dtype=metric.dtype)
    own = hold * active.dilation
    held = metric + hold * active.curvature() + damping
    # No interval counts the last controls' limits as its own: they stay.
    last = hold * jnp.diag((jnp.arange(stage) >= n).astype(metric.dtype)) + damping[:stage, :stage]
    chain = riccati.LQProblem(
        hessian=held.at[:, stage - 1, stage - 1].add(own[:-1]),
        last=last.at[-1, -1].add(own[-1]),
        flow=linear.jacobian.end * sizes / scale[:n, None],
        initial=linear.initial.jacobian * scale[:n],
        final=linear.final.jacobian * scale[:n],
    )
    return Correction(riccati.factor(chain), active, jnp.asarray(hold, metric.dtype), scale)


def corrected(
    problem: OptimalControlProblem,
    candidate: Float[Array, "nodes variables"],
    by: Correction,
    grid: Grid,
    rounds: int,
    rest: Float[Array, "intervals conditions"] | None = None,
) -> Float[Array, "nodes variables"]:
    """The candidate, moved towards the true dynamics.

    Args:
        problem: gives dynamics and constraints.
        candidate: node variables after a step.
        by: factored at the reference.
        grid: of the integration.
        rounds: of the chord method.
        rest: slack that active constraints are to be left with; by default what they have, if any.

    Returns:
        The corrected candidate; or the candidate itself, should that lack less.
    """
    n = problem.state_size

    def round_(z, _):
        out = evaluate(problem, z, grid)
        slack = slacks(problem, out)
        slack = jnp.minimum(slack, 0.0) if rest is None else slack - rest
        right = riccati.KKTVector(
            # Dilation needs no pull: its limits are linear, so that the candidate keeps them.
            nodes=-by.hold * onto_nodes(problem, by.active.pull(slack)),
            flow=(z[1:, :n] - out.end) / by.scale[:n],
            initial=jnp.zeros(by.factor.problem.initial.shape[0], z.dtype),
            final=-end_condition(problem, z[-1, :n]),
        )
        z += by.scale * riccati.solve(by.factor, right).nodes
        dilation = jnp.clip(z[:, -1], problem.dilation_min, problem.dilation_max)
        return z.at[:, -1].set(dilation), None

    better, _ = jax.lax.scan(round_, candidate, None, length=rounds)
    before, after = (_total_defect(problem, z, grid) for z in (candidate, better))
    return jnp.where(after < 0.5 * before, better, candidate)


def _total_defect(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Scalar:
    states = problem.state_size
    return jnp.sum(jnp.linalg.norm(evaluate(problem, z, grid).end - z[1:, :states], axis=1))
