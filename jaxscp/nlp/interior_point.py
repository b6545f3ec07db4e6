"""From a point near the optimum to a point of the central path: a primal-dual interior point on the nonlinear problem.

Newton's method on the conditions of ``central_path`` with slacks s = g(z) and multipliers y of their own, s o y = mu e,
in Nesterov-Todd scaling; mu falls as the iterates follow (Waechter and Biegler, "On the implementation of an
interior-point filter line-search algorithm for large-scale nonlinear programming", 2006, without its line search: what
the convex subproblems lead to is near enough). One factorisation an iteration, and second derivatives throughout:
the end is quadratic, where that of the subproblems is not.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones import product as second_order
from jaxscp.cones.cone import Cone, SecondOrder
from jaxscp.core import batching
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.linalg import riccati
from jaxscp.nlp.central_path import MU, ROOM, inverse
from jaxscp.nlp.newton_system import SecondOrderModel, along, local, newton_chain, scaled, scalings, weighed
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import (
    OptimalControlProblem,
    typical_sizes,
)
from jaxscp.transcription.inequalities import (
    Values,
    cones,
    inequalities,
    unit,
)
from jaxscp.transcription.shooting import Grid, evaluate

TO_BOUNDARY = 0.99  # share of the way to the cone's boundary that a step may go
FOLLOWED = 300.0  # times mu: error of the conditions, from which down the path is near enough for mu to fall
LONGEST = 0.3  # of a variable's typical size, that a step may change it by
LEAST_SHIFT, GROWTH, MOST_SHIFT = 1e-4, 8.0, 1e4  # of the diagonal where the second-order condition fails


class Iterate(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    y: Multipliers
    slack: Values
    mu: Scalar
    shift: Scalar
    """Added to the (scaled) curvature when last that was needed."""
    error: Scalar
    """Largest of what the conditions of the point before lack, at the final mu; infinite before that."""
    moved: Scalar
    """Largest change of a variable by the last step, in typical sizes."""
    steps: Count
    ended: Flag
    """Whether no step can be taken."""


class NLPInteriorPoint(eqx.Module):
    """Settings of the method.

    Args:
        first: mu to begin with.
        last: mu of the answer.
        tolerance: largest residual of the conditions, in typical sizes of the variables.
        settled: change of the variables by the last step, in typical sizes: along directions that hardly matter to the
            cost, the conditions alone would stop too early for derivatives.
        max_steps: Newton steps allowed.
    """

    first: float = 1e-3
    last: float = MU
    tolerance: float = 1e-8
    settled: float = 1e-6
    max_steps: int = eqx.field(default=80, static=True)

    def run(
        self,
        problem: OptimalControlProblem,
        z: Float[Array, "nodes variables"],
        y: Multipliers,
        grid: Grid,
        wanted: Flag | bool = True,
    ) -> Iterate:
        """Iterate to the end; not at all for a lane that is not wanted."""
        scale = typical_sizes(z)
        start = self.init(problem, z, y, grid)
        start = eqx.tree_at(lambda s: s.ended, start, ~jnp.asarray(wanted))

        def step(fixed, iterate):
            problem, grid, scale = fixed
            return self.step(problem, iterate, grid, scale)

        return batching.while_loop(lambda s: ~self.terminate(s), step, (problem, grid, scale), start)

    def reached(self, iterate: Iterate) -> Flag:
        """Whether an iterate is the optimum."""
        return iterate.error <= self.tolerance

    def terminate(self, iterate: Iterate) -> Flag:
        """Whether the loop is over."""
        settled = self.reached(iterate) & (iterate.moved <= self.settled)
        return settled | iterate.ended | (iterate.steps >= self.max_steps)

    def init(
        self,
        problem: OptimalControlProblem,
        z: Float[Array, "nodes variables"],
        y: Multipliers,
        grid: Grid,
    ) -> Iterate:
        """Slacks as the point has them, but far enough inside that a multiplier need not exceed the one given."""
        mu = jnp.asarray(self.first, z.dtype)
        values = inequalities(problem, z, evaluate(problem, z, grid), ROOM)
        slack = tuple(
            _inside(k, g, mu / jnp.maximum(price, jnp.sqrt(mu)))
            for k, g, price in zip(cones(problem), values, y.values, strict=True)
        )
        prices = tuple(mu * inverse(k, s) for k, s in zip(cones(problem), slack, strict=True))
        # The ends' multipliers, like the prices, follow from the rest in the first step.
        return Iterate(
            z=z,
            y=Multipliers(y.flow, y.initial, y.final, prices),
            slack=slack,
            mu=mu,
            shift=jnp.zeros_like(mu),
            error=jnp.full_like(mu, jnp.inf),
            moved=jnp.full_like(mu, jnp.inf),
            steps=jnp.zeros((), int),
            ended=jnp.zeros((), bool),
        )

    def step(
        self, problem: OptimalControlProblem, old: Iterate, grid: Grid, scale: Float[Array, "variables"]
    ) -> Iterate:
        """One Newton step."""
        here = local(problem, old.z, old.y, grid)
        weigh = scalings(problem, old.slack, old.y.values)
        inverses = tuple(inverse(k, s) for k, s in zip(cones(problem), old.slack, strict=True))
        apart = tuple(w.inverse_square(g - s) for w, s, g in zip(weigh, old.slack, here.values, strict=True))
        condensed = weighed(problem, here.jacobians, weigh, old.y.values, inverses, apart)
        priced, poles, owed = condensed.sides

        error = _error(problem, old, here, priced, scale)
        ready = (error <= FOLLOWED * old.mu) & (old.mu > self.last)
        mu = jnp.where(ready, jnp.maximum(self.last, jnp.minimum(0.2 * old.mu, old.mu**1.5)), old.mu)

        factor, shift = _definite(newton_chain(problem, here, condensed, scale), old.shift)
        gradient = mu * poles - owed - here.lack.nodes
        right = riccati.KKTVector(gradient, -here.lack.flow, -here.lack.initial, -here.lack.final)
        move = scaled(riccati.solve(factor, scaled(right, scale)), scale)

        slopes = along(problem, here.jacobians, move.nodes)
        dslack = tuple(slope + g - s for slope, g, s in zip(slopes, here.values, old.slack, strict=True))
        dprices = tuple(
            mu * pole - y - w.inverse_square(ds)
            for w, pole, y, ds in zip(weigh, inverses, old.y.values, dslack, strict=True)
        )
        dy = Multipliers(move.flow, move.initial, move.final, dprices)
        size = jnp.max(jnp.abs(move.nodes / scale))
        primal = jnp.minimum(_longest(problem, old.slack, dslack), LONGEST / jnp.maximum(size, LONGEST))
        dual = _longest(problem, old.y.values, dprices)

        good = factor.definite & jnp.isfinite(size)
        advance = lambda v, dv, t: jax.tree.map(lambda a, b: jnp.where(good, a + t * b, a), v, dv)  # noqa: E731
        return Iterate(
            z=advance(old.z, move.nodes, primal),
            y=advance(old.y, dy, dual),
            slack=advance(old.slack, dslack, primal),
            mu=mu,
            shift=shift,
            error=jnp.where(old.mu <= self.last, error, jnp.inf),
            moved=primal * size,
            steps=old.steps + 1,
            ended=~good,
        )


def _definite(chain: riccati.LQProblem, last: Scalar) -> tuple[riccati.Factor, Scalar]:
    """Factor the matrix; where the second-order condition fails, with the least shift of a rising few that mends it."""

    def another(carry):
        _, _, after = carry
        least = jnp.maximum(LEAST_SHIFT, last / GROWTH)
        return riccati.factor(chain.shifted(after)), after, jax.lax.select(after > 0, GROWTH * after, least)

    def fails(carry):
        factor, shift, _ = carry
        return ~factor.definite & (shift < MOST_SHIFT)

    none = jnp.zeros_like(last)
    factor, used, _ = jax.lax.while_loop(fails, another, (riccati.no_factor(chain), none, none))
    kept: Array = jnp.where(used > 0, used, last)
    return factor, kept


def _error(
    problem: OptimalControlProblem,
    at: Iterate,
    here: SecondOrderModel,
    priced: Float[Array, "nodes variables"],
    scale: Float[Array, "variables"],
) -> Scalar:
    dual = (here.lack.nodes - priced) * scale
    apart = [g - s for g, s in zip(here.values, at.slack, strict=True)]
    pairs = [
        (second_order.jordan_product(s, y) if isinstance(k, SecondOrder) else s * y)
        - at.mu * unit(k, s.shape[-1])
        for k, s, y in zip(cones(problem), at.slack, at.y.values, strict=True)
    ]
    parts = [dual, here.lack.flow, here.lack.initial, here.lack.final, *apart, *pairs]
    return jnp.max(jnp.stack([jnp.max(jnp.abs(part), initial=0.0) for part in parts]))


def _inside(cone: Cone, values: Float[Array, "*b rows"], least: Float[Array, "*b rows"]):
    """The values, moved in where they have less than ``least`` to the cone's boundary."""
    if not isinstance(cone, SecondOrder):
        return jnp.maximum(values, least)
    norm = jnp.linalg.norm(values[..., 1:], axis=-1)
    return values.at[..., 0].set(norm + jnp.maximum(values[..., 0] - norm, least[..., 0]))


def _longest(problem: OptimalControlProblem, point: Values, direction) -> Scalar:
    """Step, at most one, that keeps a point in the cones."""

    def one(cone: Cone, v: Array, dv: Array) -> Array:
        if isinstance(cone, SecondOrder):
            return jnp.min(second_order.step_to_boundary(v, dv))
        falls = dv < 0.0
        speed: Array = jnp.where(falls, -dv, 1.0)
        reach: Array = jnp.where(falls, v / speed, jnp.inf)
        return jnp.min(reach)

    steps = [one(k, v, dv) for k, v, dv in zip(cones(problem), point, direction, strict=True)]
    return jnp.minimum(1.0, TO_BOUNDARY * jnp.min(jnp.stack(steps)))
