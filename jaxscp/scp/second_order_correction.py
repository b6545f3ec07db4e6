"""Second-order correction: bring a step back onto the dynamics and both ends, by linear algebra alone.

Rounds of a chord method: the residuals are the candidate's, the Jacobians the reference's. Each round takes the least
correction in a metric, with a penalty on leaving the active constraints. All rounds share one factorisation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.linalg import riccati
from jaxscp.problem.end_conditions import end_residuals
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.active_set import ActiveSet, slacks
from jaxscp.transcription.layout import sum_onto_nodes
from jaxscp.transcription.shooting import Grid, Linearisation, evaluate

ACTIVE_PENALTY = (
    300.0  # penalty on leaving an active constraint, in scaled units: far above the other curvature
)
_DAMPING = 1e-2  # keeps the metric positive definite


class Correction(eqx.Module):
    """Factorisation that the corrections of all steps from one reference share."""

    factor: riccati.Factor
    """Of the conditions of a least correction, in scaled variables."""
    active: ActiveSet
    """Constraints whose violation is penalised."""
    penalty: Scalar
    """On leaving them."""
    scale: Float[Array, "variables"]
    """Typical sizes."""


class Target(eqx.Module):
    """Values that a correction aims at."""

    slack: Float[Array, "intervals conditions"]
    """Of the active constraints."""
    initial: Float[Array, "initial"]
    """Residual of the conditions at the start."""
    final: Float[Array, "final"]
    """Residual of the conditions at the end."""


def correction(
    problem: ScaledTimeProblem,
    linear: Linearisation,
    active: ActiveSet,
    metric: Float[Array, "intervals inputs inputs"],
    scale: Float[Array, "variables"],
    penalty: Scalar | float = ACTIVE_PENALTY,
) -> Correction:
    """Factor the conditions of a least correction.

    Args:
        problem: gives the sizes.
        linear: linearisation about the reference.
        active: constraints whose violation is penalised.
        metric: convex Hessian in scaled units; a correction is least in it.
        scale: typical sizes of a node's variables.
        penalty: on leaving an active constraint, in scaled units.
    """
    n, stage = problem.state_size, problem.variables
    sizes = jnp.concatenate([scale, scale[n:]])
    damping = _DAMPING * jnp.eye(sizes.shape[0], dtype=metric.dtype)
    at_limit = penalty * active.dilation
    penalised = metric + penalty * active.hessian() + damping
    # The last node's controls belong to no interval of their own: the penalty keeps them.
    last = penalty * jnp.diag((jnp.arange(stage) >= n).astype(metric.dtype)) + damping[:stage, :stage]
    system = riccati.LQProblem(
        hessian=penalised.at[:, stage - 1, stage - 1].add(at_limit[:-1]),
        last=last.at[-1, -1].add(at_limit[-1]),
        flow=linear.jacobian.end * sizes / scale[:n, None],
        initial=linear.initial.jacobian * scale[:n],
        final=linear.final.jacobian * scale[:n],
    )
    return Correction(riccati.factor(system), active, jnp.asarray(penalty, metric.dtype), scale)


def corrected(
    problem: ScaledTimeProblem,
    candidate: Float[Array, "nodes variables"],
    by: Correction,
    grid: Grid,
    rounds: int,
    target: Target | None = None,
) -> Float[Array, "nodes variables"]:
    """The candidate, corrected towards the dynamics and both ends.

    Args:
        problem: gives dynamics and constraints.
        candidate: node variables after a step.
        by: factorisation at the reference.
        grid: of the integration.
        rounds: of the chord method.
        target: slacks and end residuals after the correction; by default zero ends, and the constraints' own slack, if
            positive.

    Returns:
        The corrected candidate; or the candidate itself, if its residual is not halved.
    """
    n = problem.state_size
    aim = (0.0, 0.0) if target is None else (target.initial, target.final)

    def ends(z):
        return jax.tree.map(jnp.subtract, end_residuals(problem, z), aim)

    def one_round(z, _):
        out = evaluate(problem, z, grid)
        slack = slacks(problem, out)
        slack = jnp.minimum(slack, 0.0) if target is None else slack - target.slack
        initial, final = ends(z)
        right = riccati.KKTVector(
            # No term for the dilation: its limits are linear, so that the candidate satisfies them.
            nodes=-by.penalty * sum_onto_nodes(problem, by.active.penalty_gradient(slack)),
            flow=(z[1:, :n] - out.end) / by.scale[:n],
            initial=-initial,
            final=-final,
        )
        z += by.scale * riccati.solve(by.factor, right).nodes
        return z.at[:, -1].set(jnp.clip(z[:, -1], problem.dilation_min, problem.dilation_max)), None

    better, _ = jax.lax.scan(one_round, candidate, None, length=rounds)

    def total(z):
        defect = evaluate(problem, z, grid).end - z[1:, :n]
        return jnp.sum(jnp.linalg.norm(defect, axis=1)) + sum(map(jnp.linalg.norm, ends(z)))

    return jnp.where(total(better) < 0.5 * total(candidate), better, candidate)
