"""Primal-dual interior point on the nonlinear problem: from a point near the optimum to a point of the central path.

Newton's method on the conditions of ``central_path`` with slacks s = g(z) and multipliers y, s o y = mu e, in
Nesterov-Todd scaling. mu falls as the iterates follow the path (Waechter and Biegler, "On the implementation of an
interior-point filter line-search algorithm for large-scale nonlinear programming", 2006). There is no line search: the
convex subproblems lead near enough. Each iteration factors one matrix and uses second derivatives. So convergence is
quadratic; the subproblems alone converge more slowly. Steps that go to and fro are damped.

Far from the optimum, second-order conditions are smooth inequalities of one number (``ratio_form``): in their cones
the steps would be short. The last steps are in the cones, so that the solution is a point of their central path.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.nlp import ratio_form
from jaxscp.nlp.central_path import MU, RELAXATION
from jaxscp.nlp.newton_direction import Pairs, factor_definite, newton_direction, pairs_of
from jaxscp.nlp.newton_system import (
    SecondOrderModel,
    jacobian_product,
    newton_matrix,
    second_order_model,
)
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.inequalities import Values, cones, inequalities
from jaxscp.transcription.shooting import Grid, evaluate

FRACTION_TO_BOUNDARY = 0.99  # of the way to the cone's boundary that a step may take
# Times mu: residual below which mu may fall. The first after a Newton step that nothing shortened or corrected; else
# the tolerance of Waechter and Biegler: a path that is left there is rarely found again at a lower mu.
BARRIER_TOLERANCE_FACTOR, CAREFUL_FACTOR = 1000.0, 30.0
# Exponent of the next mu (Waechter and Biegler: 1.5), and size of the dilation relative to its typical one, as inertia
# corrections see it: they then change the mesh less, along which costs are nearly equal. With 1.5 and 1, half as many
# random chains of boxes again end over 1 % above the best cost known, in as many steps.
BARRIER_DECREASE, SIZE_OF_DILATION = 1.25, 0.3
WHOLE = 0.9  # fraction of a step that counts as all of it
MAX_STEP = 1.5  # largest step of a variable, in its typical size
MUCH_OF_THE_WAY, LEAST_DAMPING = 0.5, 1.0 / 64.0  # of the last step that a step goes back; factor of a step
IN_CONES = 1e-6  # KKT residual below which second-order conditions leave the ratio form


class Iterate(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    y: Multipliers
    slack: Values
    values: Values
    """Of the second-order conditions in their cones, predicted by the last step; other cones have no rows."""
    chosen: ratio_form.Chosen
    """Second-order conditions that are in ratio form; none in the last steps."""
    mu: Scalar
    inertia_correction: Scalar
    """Last nonzero addition to the (scaled) diagonal."""
    regular: Flag
    """Whether the last step was whole, by a matrix without correction."""
    error: Scalar
    """KKT residual of the previous iterate, at the final mu and in the cones; infinite before that."""
    step: Float[Array, "nodes variables"]
    """Change of the variables by the last step, in typical sizes."""
    damping: Scalar
    """Factor of the last step: one, or less where the iterates go to and fro."""
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

        return batching.while_loop(
            lambda s: ~self.terminate(s), step, (problem, grid, scale), start, batching.CHUNK_OF_LONG_LOOPS
        )

    def is_optimum(self, iterate: Iterate) -> Flag:
        """Whether an iterate is the optimum."""
        return iterate.error <= self.tolerance

    def terminate(self, iterate: Iterate) -> Flag:
        """Whether the loop is over."""
        whole = iterate.damping == 1.0
        converged = self.is_optimum(iterate) & whole & (jnp.max(jnp.abs(iterate.step)) <= self.step_tolerance)
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
        chosen = ratio_form.away_from_apex(problem, values)
        slack = tuple(
            cone.shift_inside(g, mu / jnp.maximum(multiplier, jnp.sqrt(mu)))
            for cone, g, multiplier in zip(
                cones(problem), ratio_form.in_ratio_form(chosen, values), y.values, strict=True
            )
        )
        multipliers = tuple(
            -mu * cone.barrier_gradient(s) for cone, s in zip(cones(problem), slack, strict=True)
        )
        # The first step replaces the multipliers of the ends and of the inequalities: they follow from the rest.
        return Iterate(
            z=z,
            y=Multipliers(y.flow, y.initial, y.final, multipliers),
            slack=slack,
            values=ratio_form.curved_alone(chosen, values),
            chosen=chosen,
            mu=mu,
            inertia_correction=jnp.zeros_like(mu),
            regular=jnp.zeros((), bool),
            error=jnp.full_like(mu, jnp.inf),
            step=jnp.zeros_like(z),
            damping=jnp.ones_like(mu),
            steps=jnp.zeros((), int),
            failed=jnp.zeros((), bool),
        )

    def step(
        self, problem: ScaledTimeProblem, old: Iterate, grid: Grid, scale: Float[Array, "variables"]
    ) -> Iterate:
        """One Newton step."""
        y = ratio_form.cone_multipliers(old.chosen, old.y, old.values)
        in_cones = second_order_model(problem, old.z, y, grid)
        model, curved = _in_ratio_form(old, in_cones)
        pairs = pairs_of(problem, old.slack, old.y.values, curved)
        error = _kkt_residual(problem, old, model, pairs, scale)
        mu = self._next_mu(old, error)
        sizes = scale.at[-1].multiply(SIZE_OF_DILATION)
        matrix = newton_matrix(problem, model, pairs.eliminated, sizes)
        factor, correction = factor_definite(matrix, old.inertia_correction)
        step = newton_direction(problem, model, pairs, mu, factor, sizes)

        size = jnp.max(jnp.abs(step.z / scale))
        damping = next_damping(old.damping, old.step, step.z / scale)
        primal = damping * jnp.minimum(
            _step_length(problem, old.slack, step.slack), MAX_STEP / jnp.maximum(size, MAX_STEP)
        )
        dual = damping * _step_length(problem, old.y.values, step.y.values)
        good = factor.definite & jnp.isfinite(size)
        advance = lambda v, dv, t: jax.tree.map(lambda a, b: jnp.where(good, a + t * b, a), v, dv)  # noqa: E731
        curved_values, slopes = (
            ratio_form.curved_alone(old.chosen, part) for part in (in_cones.values, in_cones.jacobians)
        )
        last_steps = ~ratio_form.any_of(old.chosen)
        new = Iterate(
            z=advance(old.z, step.z, primal),
            y=advance(old.y, step.y, dual),
            slack=advance(old.slack, step.slack, primal),
            values=advance(curved_values, jacobian_product(problem, slopes, step.z), primal),
            chosen=old.chosen,
            mu=mu,
            inertia_correction=jnp.where(correction > 0.0, correction, old.inertia_correction),
            regular=(primal >= WHOLE) & (correction == 0.0),
            error=jnp.where(last_steps & (old.mu <= self.final_mu), error, jnp.inf),
            step=primal * step.z / scale,
            damping=damping,
            steps=old.steps + 1,
            failed=~good,
        )
        return _into_cones(problem, new, ~last_steps & (old.mu <= self.final_mu) & (error <= IN_CONES))

    def _next_mu(self, at: Iterate, error: Scalar) -> Scalar:
        """The barrier parameter, lowered where the iterate is close to the central path."""
        mu, factor = at.mu, jnp.where(at.regular, BARRIER_TOLERANCE_FACTOR, CAREFUL_FACTOR)
        ready = (error <= factor * mu) & (mu > self.final_mu)
        return jnp.where(ready, jnp.maximum(self.final_mu, jnp.minimum(0.2 * mu, mu**BARRIER_DECREASE)), mu)


def next_damping(
    last: Scalar, last_step: Float[Array, "nodes variables"], step: Float[Array, "nodes variables"]
) -> Scalar:
    """Factor of a Newton step: half of the last one where the step goes back over the last step, else twice that.

    Near a point where a constraint begins to bind, Newton steps overshoot. Without damping they go to and fro between
    two points for ever.

    Args:
        last: factor of the last step.
        last_step: as it was taken; zero before the first.
        step: the Newton step.
    """
    back = -last * jnp.vdot(step, last_step) > MUCH_OF_THE_WAY * jnp.vdot(last_step, last_step)
    return jnp.where(back, jnp.maximum(0.5 * last, LEAST_DAMPING), jnp.minimum(2.0 * last, 1.0))


def _in_ratio_form(at: Iterate, model: SecondOrderModel) -> tuple[SecondOrderModel, SecondOrderModel]:
    """The model with the chosen conditions in ratio form, and with rows for their curvature besides."""
    values = ratio_form.in_ratio_form(at.chosen, model.values)
    plain, curved = ratio_form.jacobians_in_ratio_form(at.chosen, model.values, model.jacobians, at.slack)
    parts = lambda m: (m.values, m.jacobians)  # noqa: E731
    return eqx.tree_at(parts, model, (values, plain)), eqx.tree_at(parts, model, (values, curved))


def _into_cones(problem: ScaledTimeProblem, at: Iterate, now: Flag) -> Iterate:
    """The iterate with every condition in its cone, if ``now``."""
    leaving = jax.tree.map(lambda chosen: chosen & now, at.chosen)
    slack = ratio_form.back_to_cones(leaving, at.slack, at.values)
    central = tuple(-at.mu * cone.barrier_gradient(s) for cone, s in zip(cones(problem), slack, strict=True))
    multipliers = ratio_form.replaced(leaving, at.y.values, central)
    staying = jax.tree.map(lambda chosen: chosen & ~now, at.chosen)
    return eqx.tree_at(lambda i: (i.slack, i.y.values, i.chosen), at, (slack, multipliers, staying))


def _kkt_residual(
    problem: ScaledTimeProblem,
    at: Iterate,
    model: SecondOrderModel,
    pairs: Pairs,
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
