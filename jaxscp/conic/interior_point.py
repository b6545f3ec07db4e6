"""Primal-dual interior point for staged conic programs.

Nesterov-Todd scaling and Mehrotra's predictor and corrector. From afar it goes on in the homogeneous embedding (Goulart
and Chen, "Clarabel: an interior-point solver for conic programs with quadratic objectives", 2024), which adds two
scalars tau and kappa: at its solution either tau > 0 and x / tau solves the program, or kappa > 0 and the iterate
itself proves that the program is infeasible or unbounded. Where a point is thought to be near, a solution is thought
to exist: from there the steps are of the program itself, tau one and kappa zero, as few and with a right side less.
This is the loop; ``iterate`` has what it is at, ``directions`` where it goes from there.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscp.backends.libraries import dispatch
from jaxscp.cones import product
from jaxscp.cones.product import ConeVector
from jaxscp.conic import kkt, native
from jaxscp.conic.directions import Embedded, Newton
from jaxscp.conic.equilibrate import Scales, equilibrate
from jaxscp.conic.iterate import Iterate, Residuals, measured, residuals_at
from jaxscp.conic.kkt import Primal
from jaxscp.conic.program import ConicMultipliers, ConicSolution, StagedProgram, WarmStart
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.trees import tree_axpy, tree_negated
from jaxscp.core.types import Scalar


class Progress(eqx.Module):
    """State of the loop."""

    iterate: Iterate
    residuals: Residuals
    iterations: Int[Array, ""]
    stalled: Bool[Array, ""]
    broken: Bool[Array, ""]


class Ended(eqx.Module):
    """What the loop ended with, in the units of its scales."""

    iterate: Iterate
    error: Scalar
    infeasibility: Scalar
    unboundedness: Scalar
    iterations: Int[Array, ""]
    stalled: Bool[Array, ""]
    broken: Bool[Array, ""]
    scales: Scales


class InteriorPoint(eqx.Module):
    """Our own structured interior point; it runs under ``jit``, ``vmap`` and on any device.

    The Newton system is reduced to one block tridiagonal matrix (``kkt``), so that work and memory grow
    linearly with the number of nodes. In float64, on a CPU and on NVIDIA GPUs, the loop is the compiled one of
    ``conic.native``, where that was built; elsewhere it is pure JAX. It has no derivative; ``ConicLayer`` has.

    Args:
        tolerance: relative gap and residuals at which a program counts as solved.
        proof_tolerance: residual, relative to what it proves, at which a proof of infeasibility or of
            unboundedness counts: at 1e-6 it still excludes every point of norm below a million.
        loose_tolerance: those at which it counts as almost solved when progress ends earlier.
        max_iterations: Newton steps allowed, from each start.
        regularisation: added to the diagonal of the (equilibrated) system; its effect is refined away.
        refinements: rounds of iterative refinement for each right-hand side.
        refine_below: error, or that of a proof, from which on there is refinement: far from the end the digits that it
            brings back are not missed.
        equilibration: rounds of Ruiz scaling.
        compiled: whether ``conic.native`` may run the loop.
    """

    tolerance: float = eqx.field(default=1e-8, static=True)
    proof_tolerance: float = eqx.field(default=1e-6, static=True)
    loose_tolerance: float = eqx.field(default=1e-5, static=True)
    max_iterations: int = eqx.field(default=50, static=True)
    regularisation: float = eqx.field(default=1e-11, static=True)
    refinements: int = eqx.field(default=1, static=True)
    refine_below: float = eqx.field(default=1e-4, static=True)
    equilibration: int = eqx.field(default=3, static=True)
    compiled: bool = eqx.field(default=True, static=True)

    def __call__(
        self, program: StagedProgram, accuracy: Scalar | float = 0.0, near: WarmStart | None = None
    ) -> ConicSolution:
        """Solve a program.

        Args:
            program: to solve.
            accuracy: relative gap and residuals that are enough, if that is more than the tolerance: steps that an
                outer iteration has no use for are not taken.
            near: where the solution is thought to be, which saves steps where it is true, and makes them cheaper. Where
                it leads nowhere the loop starts again, as without it.

        Returns:
            A ``ConicSolution``; ``z`` is always finite, its ``status`` says what it is worth.
        """
        tolerance = jnp.maximum(self.tolerance, jnp.asarray(accuracy, program.gradient.dtype))
        ended = self.iterate(program, tolerance, near)
        x, y, _ = ended.iterate.solution()
        z, multipliers = restored(program, ended.scales, x, y)
        return ConicSolution(
            z, multipliers, program.objective(z), self.status(ended, tolerance), ended.iterations
        )

    def iterate(
        self, program: StagedProgram, tolerance: Scalar | float | None = None, near: WarmStart | None = None
    ) -> Ended:
        """The loop itself, on the equilibrated program; to the solver's own tolerance if to no other."""
        wanted = jnp.asarray(self.tolerance if tolerance is None else tolerance, program.gradient.dtype)
        if near is not None:
            # where nothing is known there is no number to start from, and the loop starts again
            near = eqx.tree_at(lambda n: n.z, near, jnp.where(near.known, near.z, jnp.nan))
        given = _without_derivative((program, wanted, near))
        cpu = self.compiled and native.serves(program)
        cuda = self.compiled and native.serves_on_gpu(program)
        return dispatch(
            functools.partial(self._iterate_compiled, native.call) if cpu else None,
            self._iterate,
            *given,
            cuda=functools.partial(self._iterate_compiled, native.call_on_gpu) if cuda else None,
        )

    def _iterate(self, given: StagedProgram, tolerance: Scalar, near: WarmStart | None) -> Ended:
        program, scales = equilibrate(given, self.equilibration)

        def steps(start: Progress, newton: type[Newton]) -> Progress:
            most = start.iterations + self.max_iterations
            return jax.lax.while_loop(
                lambda p: (
                    ~(self._decided(p.residuals, tolerance) | p.stalled | p.broken | (p.iterations >= most))
                ),
                lambda p: self._step(program, scales, tolerance, p, newton),
                start,
            )

        if near is None:
            progress = steps(self._start(program, scales), Embedded)
        else:
            start = _started(program, scales, Iterate.near(program, scales.apply(near)))
            progress = steps(start, Newton)
            decided = self._decided(progress.residuals, tolerance)
            anew = lambda p: eqx.tree_at(lambda q: q.iterations, self._start(program, scales), p.iterations)  # noqa: E731
            progress = steps(jax.lax.cond(decided, lambda p: p, anew, progress), Embedded)
        r = progress.residuals
        measures = r.error, r.infeasibility, r.unboundedness
        return Ended(
            progress.iterate, *measures, progress.iterations, progress.stalled, progress.broken, scales
        )

    def _iterate_compiled(
        self, call, program: StagedProgram, tolerance: Scalar, near: WarmStart | None
    ) -> Ended:
        names = (
            "proof_tolerance",
            "loose_tolerance",
            "regularisation",
            "max_iterations",
            "refinements",
            "refine_below",
            "equilibration",
        )
        settings = {name: getattr(self, name) for name in names}
        found = call(program, tolerance, near, **settings)
        z, xi, zeta, y_zero, y_orthant, y_second, s_orthant, s_second, tau, kappa, *found = found
        error, infeasibility, unboundedness, iterations, stalled, broken, *found = found
        columns, links, rows, *of_cones, scale_of_cost = found
        y, s = (
            ConeVector(y_zero, y_orthant, y_second),
            ConeVector(jnp.zeros_like(y_zero), s_orthant, s_second),
        )
        iterate = Iterate(Primal(z, xi, zeta), y, s, tau, kappa)
        scales = Scales(columns, links, rows, tuple(of_cones), scale_of_cost)
        return Ended(iterate, error, infeasibility, unboundedness, iterations, stalled, broken, scales)

    def status(self, r: Ended, tolerance: Scalar | float | None = None) -> StatusCode:
        """How the loop ended, of which its tolerance decides; the solver's own if no other."""
        tolerance = self.tolerance if tolerance is None else tolerance
        solved_status = Status.where(
            r.broken,
            Status.numerical_error,
            Status.where(r.stalled, Status.insufficient_progress, Status.iteration_limit),
        )
        solved_status = Status.where(r.error <= self.loose_tolerance, Status.almost_converged, solved_status)
        solved_status = Status.where(r.unboundedness <= self.proof_tolerance, Status.unbounded, solved_status)
        solved_status = Status.where(
            r.infeasibility <= self.proof_tolerance, Status.infeasible, solved_status
        )
        return Status.where(r.error <= tolerance, Status.converged, solved_status)

    def _start(self, program: StagedProgram, scales: Scales) -> Progress:
        """The point that solves the program with its cones replaced by a least-squares penalty."""
        unit = product.scaling(_interior_unit(program), _interior_unit(program))
        factor = kkt.factorise(program, unit, self.regularisation)
        q, b = kkt.linear_cost(program), kkt.right_side(program)
        x, y = kkt.solve(program, unit, factor, tree_negated(q), b, self.refinements)
        slack = eqx.tree_at(lambda v: v.zero, tree_negated(y), jnp.zeros_like(y.zero))
        slack = product.lift_inside(slack)
        # The bounds of the norms follow their cones, so that those rows start without residual.
        _, trust, virtual = kkt.unpack(program, slack.second)
        x = Primal(x.z, trust[:, 0], virtual[:, 0])
        iterate = Iterate(x, product.lift_inside(y), slack, jnp.ones(()), jnp.ones(()))
        return _started(program, scales, iterate)

    def _decided(self, r: Residuals, tolerance: Scalar) -> Bool[Array, ""]:
        """Whether the program is solved, or there is a proof that it has no solution."""
        return (r.error <= tolerance) | (
            jnp.minimum(r.infeasibility, r.unboundedness) <= self.proof_tolerance
        )

    def _near_the_end(self, r: Residuals) -> Bool[Array, ""]:
        return jnp.minimum(r.error, jnp.minimum(r.infeasibility, r.unboundedness)) < self.refine_below

    def _counts(self, r: Residuals, tolerance: Scalar) -> Bool[Array, ""]:
        """Whether something may be said of an iterate by these, which are then to be exact."""
        return self._near_the_end(r) | self._decided(r, tolerance) | (r.error <= self.loose_tolerance)

    def _step(
        self,
        program: StagedProgram,
        scales: Scales,
        tolerance: Scalar,
        progress: Progress,
        newton: type[Newton],
    ) -> Progress:
        old, r = progress.iterate, progress.residuals
        near = self._near_the_end(r)
        refinements = jnp.where(near, self.refinements, 0) if self.refinements else 0
        directions = newton(program, old, self.regularisation, refinements)

        affine = directions.predictor(r)
        enough = directions.suffices(r, affine, tolerance)
        sigma = jnp.where(enough, 0.0, directions.centring(affine))
        corrected = directions.corrector(r, affine, sigma)
        direction = jax.tree.map(lambda a, b: jnp.where(enough, a, b), affine, corrected)
        primal, dual = (directions.part * length for length in directions.longest_steps(direction))

        new = tree_axpy(primal, direction, old)
        new = eqx.tree_at(lambda v: v.y, new, tree_axpy(dual, direction.y, old.y))
        unit = 1.0 / jnp.maximum(new.tau, new.kappa)
        new = jax.tree.map(lambda v: unit * v, new)

        # Far from the end the residuals are those that are left if the direction solves its equations. Nothing is
        # said of an iterate by them.
        left = jax.tree.map(lambda v: unit * (1.0 - dual * (1.0 - sigma)) * v, r.x)
        left = left, jax.tree.map(lambda v: unit * (1.0 - primal * (1.0 - sigma)) * v, r.y)
        foreseen, found = measured(program, scales, new, *left), residuals_at(program, scales, new)
        exact = near | self._counts(foreseen, tolerance)
        residuals = jax.tree.map(lambda a, b: jnp.where(exact, a, b), found, foreseen)

        broken = ~(jnp.isfinite(residuals.error) & jnp.isfinite(residuals.mu))
        # A step that makes a nearly solved iterate worse has run into rounding: keep the better one.
        worse = (r.error < self.loose_tolerance) & (residuals.error > 2.0 * r.error)
        stalled = (jnp.minimum(primal, dual) < 1e-6) | worse
        keep = broken | (stalled & (residuals.error > r.error))
        new, residuals = jax.tree.map(lambda a, b: jnp.where(keep, a, b), (old, r), (new, residuals))
        return Progress(new, residuals, progress.iterations + 1, stalled, broken)


@jax.custom_jvp
def _without_derivative(given):
    """What the iterations start from; to differentiate them is an error, whatever device they run on."""
    return given


@_without_derivative.defjvp
def _refuse(primals, tangents):
    raise TypeError(
        "the interior point has no derivative: jaxscp.conic.ConicLayer is the conic step as a differentiable function; "
        "where none is wanted, give it jax.lax.stop_gradient(program)"
    )


def restored(
    program: StagedProgram, scales: Scales, x: Primal, y: ConeVector
) -> tuple[Float[Array, "nodes variables"], ConicMultipliers]:
    """Node variables and multipliers of the given program, from those of the equilibrated one."""
    user, _, _ = kkt.unpack(program, y.second)
    return scales.restore(x.z, ConicMultipliers(kkt.link_multiplier(program, y), y.orthant, tuple(user)))


def _started(program: StagedProgram, scales: Scales, iterate: Iterate) -> Progress:
    residuals = residuals_at(program, scales, iterate)
    none, false = jnp.zeros((), int), jnp.zeros((), bool)
    return Progress(iterate, residuals, none, false, ~jnp.isfinite(residuals.error))


def _interior_unit(program: StagedProgram) -> ConeVector:
    return product.identity(kkt.right_side(program))
