"""The interior point's loop as JAX: starting point, step, stopping test.

``iterate`` has the iterates, ``residuals`` their measures, and ``directions`` the Newton directions.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxscp.conic.directions import Embedded, Newton
from jaxscp.conic.equilibrate import Scales, equilibrate
from jaxscp.conic.iterate import Iterate
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.conic.residuals import Residuals, residuals_at, with_measures
from jaxscp.conic.settings import Settings
from jaxscp.core.trees import tree_axpy, tree_where
from jaxscp.core.types import Flag, Scalar

SHORTEST_STEP = 1e-6  # a shorter step is no progress
WORSE = 2.0  # factor by which the error of a nearly solved iterate may grow


class LoopState(eqx.Module):
    """State of the loop."""

    iterate: Iterate
    residuals: Residuals
    iterations: Int[Array, ""]
    stalled: Bool[Array, ""]
    """Whether the last step made no progress."""
    broken: Bool[Array, ""]
    """Whether the last step was not finite."""


class LoopResult(eqx.Module):
    """Result of the loop, in equilibrated units, with the scales of these units."""

    iterate: Iterate
    error: Scalar
    infeasibility: Scalar
    unboundedness: Scalar
    iterations: Int[Array, ""]
    stalled: Bool[Array, ""]
    broken: Bool[Array, ""]
    scales: Scales


class Loop(eqx.Module):
    """The loop on one equilibrated program."""

    program: StagedProgram
    scales: Scales
    tolerance: Scalar
    settings: Settings

    def cold_start(self) -> LoopState:
        """State at the least-squares starting point."""
        iterate = Iterate.from_least_squares(
            self.program, self.settings.regularisation, self.settings.refinements
        )
        return self._state(iterate)

    def warm_start(self, estimate: WarmStart) -> LoopState:
        """State near an estimate of the solution, which is given in equilibrated units."""
        return self._state(Iterate.from_warm_start(self.program, estimate))

    def run(self, start: LoopState, newton: type[Newton]) -> LoopState:
        """State after as many steps as are needed and allowed."""
        limit = start.iterations + self.settings.max_iterations
        return jax.lax.while_loop(
            lambda p: ~(self.decided(p.residuals) | p.stalled | p.broken | (p.iterations >= limit)),
            lambda p: self.step(p, newton),
            start,
        )

    def decided(self, r: Residuals) -> Flag:
        """Whether the program is solved, or proved infeasible or unbounded."""
        return (r.error <= self.tolerance) | (
            jnp.minimum(r.infeasibility, r.unboundedness) <= self.settings.proof_tolerance
        )

    def step(self, state: LoopState, newton: type[Newton]) -> LoopState:
        """State after one predictor-corrector step."""
        old, r = state.iterate, state.residuals
        close = self._close_to_end(r)
        refinements = jnp.where(close, self.settings.refinements, 0) if self.settings.refinements else 0
        directions = newton(self.program, old, self.settings.regularisation, refinements)

        affine = directions.predictor(r)
        enough = directions.suffices(r, affine, self.tolerance)
        sigma = jnp.where(enough, 0.0, directions.centring(affine))
        corrected = directions.corrector(r, affine, sigma)
        direction = tree_where(enough, affine, corrected)
        primal, dual = (directions.step_fraction * length for length in directions.longest_steps(direction))

        new = tree_axpy(primal, direction, old)
        new = eqx.tree_at(lambda v: v.y, new, tree_axpy(dual, direction.y, old.y))
        unit = 1.0 / jnp.maximum(
            new.tau, new.kappa
        )  # the embedding is homogeneous: this bounds tau and kappa
        new = jax.tree.map(lambda v: unit * v, new)

        # Residuals if the direction solves its equations exactly. They are good enough far from the end.
        rx = jax.tree.map(lambda v: unit * (1.0 - dual * (1.0 - sigma)) * v, r.x)
        ry = jax.tree.map(lambda v: unit * (1.0 - primal * (1.0 - sigma)) * v, r.y)
        predicted = with_measures(self.program, self.scales, new, rx, ry)
        computed = residuals_at(self.program, self.scales, new)
        exact = close | self._needs_exact_residuals(predicted)
        residuals = tree_where(exact, computed, predicted)
        return self._accept(state, new, residuals, jnp.minimum(primal, dual))

    def _accept(self, state: LoopState, new: Iterate, residuals: Residuals, length: Scalar) -> LoopState:
        """State with the new iterate, or with the old one if the step failed."""
        old, r = state.iterate, state.residuals
        broken = ~(jnp.isfinite(residuals.error) & jnp.isfinite(residuals.mu))
        # A step that makes a nearly solved iterate worse is dominated by rounding: the better iterate remains.
        worse = (r.error < self.settings.loose_tolerance) & (residuals.error > WORSE * r.error)
        stalled = (length < SHORTEST_STEP) | worse
        reject = broken | (stalled & (residuals.error > r.error))
        new, residuals = tree_where(reject, (old, r), (new, residuals))
        return LoopState(new, residuals, state.iterations + 1, stalled, broken)

    def _close_to_end(self, r: Residuals) -> Flag:
        """Whether the error or a proof is small enough for iterative refinement to matter."""
        return (
            jnp.minimum(r.error, jnp.minimum(r.infeasibility, r.unboundedness)) < self.settings.refine_below
        )

    def _needs_exact_residuals(self, r: Residuals) -> Flag:
        """Whether a decision may follow from these residuals, so that predicted ones are not good enough."""
        return self._close_to_end(r) | self.decided(r) | (r.error <= self.settings.loose_tolerance)

    def _state(self, iterate: Iterate) -> LoopState:
        residuals = residuals_at(self.program, self.scales, iterate)
        zero, false = jnp.zeros((), int), jnp.zeros((), bool)
        return LoopState(iterate, residuals, zero, false, ~jnp.isfinite(residuals.error))


def run_loop(
    program: StagedProgram, tolerance: Scalar, warm_start: WarmStart | None, settings: Settings
) -> LoopResult:
    """Result of the loop on a program in the user's units, which is equilibrated first.

    From a warm start the loop works on the program itself. If that does not decide, the loop starts again, cold and in
    the homogeneous embedding.
    """
    program, scales = equilibrate(program, settings.equilibration)
    loop = Loop(program, scales, tolerance, settings)
    if warm_start is None:
        state = loop.run(loop.cold_start(), Embedded)
    else:
        state = loop.run(loop.warm_start(scales.apply(warm_start)), Newton)

        def restart(p):
            return eqx.tree_at(lambda q: q.iterations, loop.cold_start(), p.iterations)

        start = jax.lax.cond(loop.decided(state.residuals), lambda p: p, restart, state)
        state = loop.run(start, Embedded)
    r = state.residuals
    measures = r.error, r.infeasibility, r.unboundedness
    return LoopResult(state.iterate, *measures, state.iterations, state.stalled, state.broken, scales)
