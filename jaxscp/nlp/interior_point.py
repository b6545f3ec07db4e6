"""Primal-dual interior point on the nonlinear problem: from a point near the optimum to a point of the central path.

Newton's method on the conditions of ``central_path`` with slacks s = g(z) and multipliers y, s o y = mu e, in
Nesterov-Todd scaling. mu falls as the iterates follow the path (Waechter and Biegler, "On the implementation of an
interior-point filter line-search algorithm for large-scale nonlinear programming", 2006). There is no line search: the
convex subproblems lead near enough. Each iteration factors one matrix and uses second derivatives. So convergence is
quadratic; the subproblems alone converge more slowly.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.linalg import riccati
from jaxscp.nlp.central_path import MU, RELAXATION
from jaxscp.nlp.newton_system import (
    EliminatedInequalities,
    Scalings,
    SecondOrderModel,
    eliminate_inequalities,
    jacobian_product,
    newton_matrix,
    scaled,
    scalings,
    second_order_model,
)
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import Values, cones, inequalities
from jaxscp.transcription.shooting import Grid, evaluate

FRACTION_TO_BOUNDARY = 0.99  # of the way to the cone's boundary that a step may take
BARRIER_TOLERANCE_FACTOR = 300.0  # times mu: residual below which mu may fall
MAX_STEP = 0.3  # largest step of a variable, in its typical size
LEAST_CORRECTION, GROWTH, MOST_CORRECTION = 1e-4, 8.0, 1e4  # of the diagonal, where the matrix is indefinite


class Iterate(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    y: Multipliers
    slack: Values
    mu: Scalar
    inertia_correction: Scalar
    """Last nonzero addition to the (scaled) diagonal."""
    error: Scalar
    """KKT residual of the previous iterate, at the final mu; infinite before that."""
    step_norm: Scalar
    """Largest change of a variable by the last step, in typical sizes."""
    steps: Count
    failed: Flag
    """Whether no step can be taken."""


class NLPInteriorPoint(eqx.Module):
    """Settings of the interior point.

    Args:
        initial_mu: barrier parameter at the start.
        final_mu: barrier parameter of the solution.
        tolerance: largest KKT residual, in typical sizes of the variables.
        step_tolerance: largest last step, in typical sizes. Along directions that hardly change the cost, the residual
            alone would stop too early for derivatives.
        max_steps: Newton steps allowed.
    """

    initial_mu: float = 1e-3
    final_mu: float = MU
    tolerance: float = 1e-8
    step_tolerance: float = 1e-6
    max_steps: int = eqx.field(default=80, static=True)

    def run(
        self,
        problem: ScaledTimeProblem,
        z: Float[Array, "nodes variables"],
        y: Multipliers,
        grid: Grid,
        enabled: Flag | bool = True,
    ) -> Iterate:
        """Iterate to the end; a batch element that is not enabled takes no step."""
        scale = typical_sizes(z)
        start = self.init(problem, z, y, grid)
        start = eqx.tree_at(lambda s: s.failed, start, ~jnp.asarray(enabled))

        def step(fixed, iterate):
            problem, grid, scale = fixed
            return self.step(problem, iterate, grid, scale)

        return batching.while_loop(lambda s: ~self.terminate(s), step, (problem, grid, scale), start)

    def is_optimum(self, iterate: Iterate) -> Flag:
        """Whether an iterate is the optimum."""
        return iterate.error <= self.tolerance

    def terminate(self, iterate: Iterate) -> Flag:
        """Whether the loop is over."""
        converged = self.is_optimum(iterate) & (iterate.step_norm <= self.step_tolerance)
        return converged | iterate.failed | (iterate.steps >= self.max_steps)

    def init(
        self,
        problem: ScaledTimeProblem,
        z: Float[Array, "nodes variables"],
        y: Multipliers,
        grid: Grid,
    ) -> Iterate:
        """First iterate: slacks s of the point, raised to mu / max(y, sqrt(mu)), so that mu / s exceeds neither."""
        mu = jnp.asarray(self.initial_mu, z.dtype)
        values = inequalities(problem, z, evaluate(problem, z, grid), RELAXATION)
        slack = tuple(
            cone.shift_inside(g, mu / jnp.maximum(multiplier, jnp.sqrt(mu)))
            for cone, g, multiplier in zip(cones(problem), values, y.values, strict=True)
        )
        multipliers = tuple(
            -mu * cone.barrier_gradient(s) for cone, s in zip(cones(problem), slack, strict=True)
        )
        # The first step replaces the multipliers of the ends and of the inequalities: they follow from the rest.
        return Iterate(
            z=z,
            y=Multipliers(y.flow, y.initial, y.final, multipliers),
            slack=slack,
            mu=mu,
            inertia_correction=jnp.zeros_like(mu),
            error=jnp.full_like(mu, jnp.inf),
            step_norm=jnp.full_like(mu, jnp.inf),
            steps=jnp.zeros((), int),
            failed=jnp.zeros((), bool),
        )

    def step(
        self, problem: ScaledTimeProblem, old: Iterate, grid: Grid, scale: Float[Array, "variables"]
    ) -> Iterate:
        """One Newton step."""
        model = second_order_model(problem, old.z, old.y, grid)
        pairs = _pairs(problem, old, model)
        error = _kkt_residual(problem, old, model, pairs, scale)
        mu = self._next_mu(old.mu, error)
        factor, correction = _factor_definite(
            newton_matrix(problem, model, pairs.eliminated, scale), old.inertia_correction
        )
        step = _direction(problem, old, model, pairs, mu, factor, scale)

        size = jnp.max(jnp.abs(step.z / scale))
        primal = jnp.minimum(
            _step_length(problem, old.slack, step.slack), MAX_STEP / jnp.maximum(size, MAX_STEP)
        )
        dual = _step_length(problem, old.y.values, step.y.values)
        good = factor.definite & jnp.isfinite(size)
        advance = lambda v, dv, t: jax.tree.map(lambda a, b: jnp.where(good, a + t * b, a), v, dv)  # noqa: E731
        return Iterate(
            z=advance(old.z, step.z, primal),
            y=advance(old.y, step.y, dual),
            slack=advance(old.slack, step.slack, primal),
            mu=mu,
            inertia_correction=correction,
            error=jnp.where(old.mu <= self.final_mu, error, jnp.inf),
            step_norm=primal * size,
            steps=old.steps + 1,
            failed=~good,
        )

    def _next_mu(self, mu: Scalar, error: Scalar) -> Scalar:
        """The barrier parameter, lowered where the iterate is close to the central path."""
        ready = (error <= BARRIER_TOLERANCE_FACTOR * mu) & (mu > self.final_mu)
        return jnp.where(ready, jnp.maximum(self.final_mu, jnp.minimum(0.2 * mu, mu**1.5)), mu)


class _Pairs(eqx.Module):
    """The slacks and multipliers of all inequalities at an iterate."""

    scalings: Scalings
    """W."""
    barrier_gradients: Values
    """Of the slacks."""
    eliminated: EliminatedInequalities
    """With J' times multipliers, barrier gradients and scaled slack residuals W^-2 (g - s)."""


def _pairs(problem: ScaledTimeProblem, at: Iterate, model: SecondOrderModel) -> _Pairs:
    w = scalings(problem, at.slack, at.y.values)
    gradients = tuple(cone.barrier_gradient(s) for cone, s in zip(cones(problem), at.slack, strict=True))
    residuals = tuple(
        scaling.inverse_square(g - s) for scaling, s, g in zip(w, at.slack, model.values, strict=True)
    )
    eliminated = eliminate_inequalities(problem, model.jacobians, w, at.y.values, gradients, residuals)
    return _Pairs(w, gradients, eliminated)


class _Step(eqx.Module):
    """A Newton direction."""

    z: Float[Array, "nodes variables"]
    y: Multipliers
    slack: Values


def _direction(
    problem: ScaledTimeProblem,
    old: Iterate,
    model: SecondOrderModel,
    pairs: _Pairs,
    mu: Scalar,
    factor: riccati.Factor,
    scale: Float[Array, "variables"],
) -> _Step:
    """Newton direction towards the central path at mu."""
    _, barrier, slack_residual = pairs.eliminated.products
    rhs = model.residual
    gradient = -mu * barrier - slack_residual - rhs.nodes
    right = riccati.KKTVector(gradient, -rhs.flow, -rhs.initial, -rhs.final)
    move = scaled(riccati.solve(factor, scaled(right, scale)), scale)
    derivatives = jacobian_product(problem, model.jacobians, move.nodes)
    slack = tuple(d + g - s for d, g, s in zip(derivatives, model.values, old.slack, strict=True))
    multipliers = tuple(
        -mu * gradient - y - w.inverse_square(ds)
        for w, gradient, y, ds in zip(
            pairs.scalings, pairs.barrier_gradients, old.y.values, slack, strict=True
        )
    )
    return _Step(move.nodes, Multipliers(move.flow, move.initial, move.final, multipliers), slack)


def _factor_definite(matrix: riccati.LQProblem, last: Scalar) -> tuple[riccati.Factor, Scalar]:
    """Factor of the matrix, and the inertia correction used: the least of a rising sequence that makes it definite.

    The correction is zero where the second-order condition holds.
    """

    def retry(carry):
        _, _, after = carry
        least = jnp.maximum(LEAST_CORRECTION, last / GROWTH)
        return (
            riccati.factor(matrix.shifted(after)),
            after,
            jax.lax.select(after > 0, GROWTH * after, least),
        )

    def fails(carry):
        factor, correction, _ = carry
        return ~factor.definite & (correction < MOST_CORRECTION)

    none = jnp.zeros_like(last)
    factor, used, _ = jax.lax.while_loop(fails, retry, (riccati.no_factor(matrix), none, none))
    remembered: Array = jnp.where(used > 0, used, last)
    return factor, remembered


def _kkt_residual(
    problem: ScaledTimeProblem,
    at: Iterate,
    model: SecondOrderModel,
    pairs: _Pairs,
    scale: Float[Array, "variables"],
) -> Scalar:
    """Largest residual of the optimality conditions at an iterate and its mu."""
    rhs, (multiplier_product, *_) = model.residual, pairs.eliminated.products
    dual = (rhs.nodes - multiplier_product) * scale
    slack_residuals = [g - s for g, s in zip(model.values, at.slack, strict=True)]
    complementarity = [
        cone.jordan_product(s, y) - at.mu * cone.identity(s.shape[-1])
        for cone, s, y in zip(cones(problem), at.slack, at.y.values, strict=True)
    ]
    parts = [dual, rhs.flow, rhs.initial, rhs.final, *slack_residuals, *complementarity]
    return jnp.max(jnp.stack([jnp.max(jnp.abs(part), initial=0.0) for part in parts]))


def _step_length(problem: ScaledTimeProblem, point: Values, direction: Values) -> Scalar:
    """Step, at most one, that keeps a point in the cones."""
    steps = [cone.step_length(v, dv) for cone, v, dv in zip(cones(problem), point, direction, strict=True)]
    return jnp.minimum(1.0, FRACTION_TO_BOUNDARY * jnp.min(jnp.stack(steps)))
