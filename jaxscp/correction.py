"""Second-order correction: take back what a step lacks because the dynamics curve, not by a subproblem but by
linear algebra.

Rounds of a chord method: the residuals are those of the candidate, the Jacobians those of the reference, and the
answer is the least one in a metric, with the active constraints held. All rounds share one factorisation.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.active_set import ActiveSet, slacks
from jaxscp.conic import block_tridiagonal
from jaxscp.conic.program import Links
from jaxscp.intervals import Grid, evaluate
from jaxscp.problem import OptimalControlProblem, end_condition
from jaxscp.types import Scalar

HOLD = (
    300.0  # usual price of leaving an active constraint, in scaled units: far above the curvature of the rest
)
_DAMPING = 1e-2  # keeps the metric positive definite
_TINY = 1e-9  # on the diagonal for link rows that say nothing


def corrected(
    problem: OptimalControlProblem,
    candidate: Float[Array, "nodes variables"],
    links: Links,
    active: ActiveSet,
    metric: Float[Array, "intervals inputs inputs"],
    scale: Float[Array, "inputs"],
    grid: Grid,
    rounds: int,
    hold: Scalar | float = HOLD,
    rest: Float[Array, "intervals conditions"] | None = None,
) -> Float[Array, "nodes variables"]:
    """The candidate, moved towards the true dynamics.

    Args:
        problem: gives dynamics and constraints.
        candidate: node variables after a step.
        links: linearised dynamics that the step obeys.
        active: constraints that it ended on.
        metric: convex curvature in scaled units; the correction is least in it.
        scale: typical sizes of an interval's variables.
        grid: of the integration.
        rounds: of the chord method.
        hold: price of leaving an active constraint, in scaled units.
        rest: slack that active constraints are to be left with; by default what they have, if any.

    Returns:
        The corrected candidate; or the candidate itself, should that lack less.
    """
    states = problem.state_size
    solve = _least_step(links, _held(metric, active, states, problem.variables, hold), scale)

    def round_(z, _):
        out = evaluate(problem, z, grid)
        lack = jnp.zeros_like(links.offset).at[1:-1, :states].set(z[1:, :states] - out.end)
        missed = end_condition(problem, z[-1, :states])[1]
        lack = lack.at[-1, : missed.shape[0]].set(-missed)
        slack = slacks(problem, out)
        slack = jnp.minimum(slack, 0.0) if rest is None else slack - rest
        # Dilation needs no pull: its limits are linear, so that the candidate keeps them.
        pull = jnp.zeros((problem.nodes, scale.shape[0])).at[:-1].set(active.pull(slack))
        step = solve(hold * pull, lack)
        dilation = jnp.clip(
            z[:, -1] + step[:, problem.variables - 1], problem.dilation_min, problem.dilation_max
        )
        return (z + step[:, : problem.variables]).at[:, -1].set(dilation), None

    better, _ = jax.lax.scan(round_, candidate, None, length=rounds)
    before, after = (_total_defect(problem, z, grid) for z in (candidate, better))
    return jnp.where(after < 0.5 * before, better, candidate)


def _held(
    metric: Float[Array, "intervals inputs inputs"],
    active: ActiveSet,
    states: int,
    variables: int,
    hold: Scalar | float,
) -> Float[Array, "nodes inputs inputs"]:
    """The metric with a price on leaving active constraints; the last node's controls, whose limits no interval
    counts as its own, stay."""
    inputs = metric.shape[-1]
    held = jnp.zeros((metric.shape[0] + 1, inputs, inputs)).at[:-1].set(metric + hold * active.curvature())
    held = held.at[:, variables - 1, variables - 1].add(hold * active.dilation)
    last = jnp.diag((jnp.arange(inputs) >= states).astype(metric.dtype))
    return held.at[-1].add(hold * last) + _DAMPING * jnp.eye(inputs)


def _least_step(links: Links, metric: Float[Array, "nodes inputs inputs"], scale: Float[Array, "inputs"]):
    """Factor once; returns the function (gradient, lack) -> step that minimises
    1/2 p' metric p + gradient . p subject to links p = lack, p in scaled units, the step in the variables' own."""
    lower = jnp.linalg.cholesky(metric)
    divide = jax.vmap(lambda factor, b: jax.scipy.linalg.cho_solve((factor, True), b))
    before, after = links.before * scale, links.after * scale
    divided_before = divide(lower, jnp.swapaxes(before[1:], 1, 2))
    divided_after = divide(lower, jnp.swapaxes(after[:-1], 1, 2))
    rows = before.shape[1]
    diagonal = jnp.broadcast_to(_TINY * jnp.eye(rows), (before.shape[0], rows, rows))
    diagonal = diagonal.at[1:].add(jnp.einsum("lrn,lns->lrs", before[1:], divided_before))
    diagonal = diagonal.at[:-1].add(jnp.einsum("lrn,lns->lrs", after[:-1], divided_after))
    above = jnp.zeros_like(diagonal).at[:-1].set(jnp.einsum("lrn,lns->lrs", after[:-1], divided_before))
    factor = block_tridiagonal.factor(diagonal, above)

    def solve(gradient, lack):
        free = -divide(lower, gradient[..., None])[..., 0]
        price = block_tridiagonal.solve(factor, links.apply(scale * free) - lack)
        return scale * (free - divide(lower, (scale * links.transpose_apply(price))[..., None])[..., 0])

    return solve


def _total_defect(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Scalar:
    states = problem.state_size
    return jnp.sum(jnp.linalg.norm(evaluate(problem, z, grid).end - z[1:, :states], axis=1))
