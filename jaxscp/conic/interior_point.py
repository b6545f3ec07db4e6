"""Primal-dual interior point for staged conic programs.

Nesterov-Todd scaling and Mehrotra's predictor and corrector. From afar it goes on in the homogeneous embedding (Goulart
and Chen, "Clarabel: an interior-point solver for conic programs with quadratic objectives", 2024), which adds two
scalars tau and kappa: at its solution either tau > 0 and x / tau solves the program, or kappa > 0 and the iterate
itself proves that the program is infeasible or unbounded. Where a point is thought to be near, a solution is thought
to exist: from there the steps are of the program itself, tau one and kappa zero, as few and with a right side less.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscp.conic import cones, kkt, native
from jaxscp.conic.cones import ConeVector, tree_axpy, tree_dot, tree_max
from jaxscp.conic.equilibrate import Scales, equilibrate
from jaxscp.conic.kkt import Primal
from jaxscp.conic.near import central_start
from jaxscp.conic.program import ConicSolution, Multipliers, Near, StagedProgram
from jaxscp.libraries import choose
from jaxscp.status import Status, StatusCode
from jaxscp.types import Count, Scalar


class Iterate(eqx.Module):
    """A point of the homogeneous embedding; of the program itself where tau is one and kappa zero."""

    x: Primal
    y: ConeVector
    s: ConeVector
    tau: Scalar
    kappa: Scalar

    def solution(self) -> tuple[Primal, ConeVector, ConeVector]:
        """Variables, multipliers and slacks of the program itself, where it is solved."""
        tau = jnp.maximum(self.tau, 1e-12)
        return jax.tree.map(lambda v: v / tau, (self.x, self.y, self.s))

    @classmethod
    def near(cls, program: StagedProgram, near: Near) -> "Iterate":
        """The start near a point that is thought to be not far from the solution."""
        x, y, s = central_start(program, near)
        return cls(x, y, s, jnp.ones(()), jnp.zeros(()))


class Residuals(eqx.Module):
    """What the embedding's equations lack, and the measures that end the iteration."""

    x: Primal
    y: ConeVector
    tau: Scalar
    mu: Scalar
    error: Scalar
    """Largest of relative gap, primal and dual residual."""
    infeasibility: Scalar
    """How well the iterate proves infeasibility; a proof at zero."""
    unboundedness: Scalar
    """How well the iterate proves unboundedness; a proof at zero."""


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
        self, program: StagedProgram, accuracy: Scalar | float = 0.0, near: Near | None = None
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
        self, program: StagedProgram, tolerance: Scalar | float | None = None, near: Near | None = None
    ) -> Ended:
        """The loop itself, on the equilibrated program; to the solver's own tolerance if to no other."""
        wanted = jnp.asarray(self.tolerance if tolerance is None else tolerance, program.gradient.dtype)
        if near is not None:
            # where nothing is known there is no number to start from, and the loop starts again
            near = eqx.tree_at(lambda n: n.z, near, jnp.where(near.known, near.z, jnp.nan))
        given = _without_derivative((program, wanted, near))
        cpu = self.compiled and native.serves(program)
        cuda = self.compiled and native.serves_on_gpu(program)
        return choose(
            functools.partial(self._iterate_compiled, native.call) if cpu else None,
            self._iterate,
            *given,
            cuda=functools.partial(self._iterate_compiled, native.call_on_gpu) if cuda else None,
        )

    def _iterate(self, given: StagedProgram, tolerance: Scalar, near: Near | None) -> Ended:
        program, scales = equilibrate(given, self.equilibration)

        def steps(start: Progress, newton: type[_Newton]) -> Progress:
            most = start.iterations + self.max_iterations
            return jax.lax.while_loop(
                lambda p: (
                    ~(self._decided(p.residuals, tolerance) | p.stalled | p.broken | (p.iterations >= most))
                ),
                lambda p: self._step(program, scales, tolerance, p, newton),
                start,
            )

        if near is None:
            progress = steps(self._start(program, scales), _Embedded)
        else:
            start = _started(program, scales, Iterate.near(program, scales.apply(near)))
            progress = steps(start, _Newton)
            decided = self._decided(progress.residuals, tolerance)
            anew = lambda p: eqx.tree_at(lambda q: q.iterations, self._start(program, scales), p.iterations)  # noqa: E731
            progress = steps(jax.lax.cond(decided, lambda p: p, anew, progress), _Embedded)
        r = progress.residuals
        measures = r.error, r.infeasibility, r.unboundedness
        return Ended(
            progress.iterate, *measures, progress.iterations, progress.stalled, progress.broken, scales
        )

    def _iterate_compiled(self, call, program: StagedProgram, tolerance: Scalar, near: Near | None) -> Ended:
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
        unit = cones.scaling(_interior_unit(program), _interior_unit(program))
        factor = kkt.factorise(program, unit, self.regularisation)
        q, b = kkt.linear_cost(program), kkt.right_side(program)
        x, y = kkt.solve(program, unit, factor, _negated(q), b, self.refinements)
        slack = eqx.tree_at(lambda v: v.zero, _negated(y), jnp.zeros_like(y.zero))
        slack = cones.lift_inside(slack)
        # The bounds of the norms follow their cones, so that those rows start without residual.
        _, trust, virtual = kkt.unpack(program, slack.second)
        x = Primal(x.z, trust[:, 0], virtual[:, 0])
        iterate = Iterate(x, cones.lift_inside(y), slack, jnp.ones(()), jnp.ones(()))
        return _started(program, scales, iterate)

    def _decided(self, r: Residuals, tolerance: Scalar) -> Bool[Array, ""]:
        """Whether the program is solved, or there is a proof that it has no solution."""
        return (r.error <= tolerance) | (
            jnp.minimum(r.infeasibility, r.unboundedness) <= self.proof_tolerance
        )

    def _near_the_end(self, r: Residuals) -> Bool[Array, ""]:
        return jnp.minimum(r.error, jnp.minimum(r.infeasibility, r.unboundedness)) < self.refine_below

    def _step(
        self,
        program: StagedProgram,
        scales: Scales,
        tolerance: Scalar,
        progress: Progress,
        newton: "type[_Newton]",
    ) -> Progress:
        old, r = progress.iterate, progress.residuals
        near = self._near_the_end(r)
        refinements = jnp.where(near, self.refinements, 0) if self.refinements else 0
        directions = newton(program, old, self.regularisation, refinements)

        affine = directions.predictor(r)
        sigma = directions.centring(affine)
        direction = directions.corrector(r, affine, sigma)
        primal, dual = (directions.part * length for length in directions.longest_steps(direction))

        new = tree_axpy(primal, direction, old)
        new = eqx.tree_at(lambda v: v.y, new, tree_axpy(dual, direction.y, old.y))
        unit = 1.0 / jnp.maximum(new.tau, new.kappa)
        new = jax.tree.map(lambda v: unit * v, new)

        # Far from the end the residuals are those that are left if the direction solves its equations. Nothing is
        # said of an iterate by them.
        left = jax.tree.map(lambda v: unit * (1.0 - dual * (1.0 - sigma)) * v, r.x)
        left = left, jax.tree.map(lambda v: unit * (1.0 - primal * (1.0 - sigma)) * v, r.y)
        foreseen, found = _measured(program, scales, new, *left), _residuals(program, scales, new)
        counts = self._near_the_end(foreseen) | self._decided(foreseen, tolerance)
        exact = near | counts | (foreseen.error <= self.loose_tolerance)
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
) -> tuple[Float[Array, "nodes variables"], Multipliers]:
    """Node variables and multipliers of the given program, from those of the equilibrated one."""
    user, _, _ = kkt.unpack(program, y.second)
    return scales.restore(x.z, Multipliers(kkt.link_multiplier(program, y), y.orthant, tuple(user)))


class _Newton:
    """Newton directions of the program at one iterate, and how far to go along them."""

    part = 0.98  # of the way to the boundary

    def __init__(
        self, program: StagedProgram, iterate: Iterate, regularisation: float, refinements: Count | int
    ):
        self.program, self.iterate = program, iterate
        self.scaling = cones.scaling(iterate.s, iterate.y)
        factor = kkt.factorise(program, self.scaling, regularisation)
        self._solve = lambda rx, ry: kkt.solve(program, self.scaling, factor, rx, ry, refinements)

    def predictor(self, r: Residuals) -> Iterate:
        """The affine direction, which aims at s = 0."""
        solution = self._solve_affine(self._right_side(r, 1.0, self.iterate.s))
        return self._direction(r, 1.0, self.iterate.tau * self.iterate.kappa, solution, self.iterate.s)

    def corrector(self, r: Residuals, affine: Iterate, sigma: Scalar) -> Iterate:
        """Mehrotra's combined direction: centring by sigma and second-order correction."""
        cross = cones.product(self.scaling.apply_inverse(affine.s), self.scaling.apply(affine.y))
        target = tree_axpy(-sigma * r.mu, cones.identity(affine.s), cross)
        target_tau = self.iterate.tau * self.iterate.kappa + affine.tau * affine.kappa - sigma * r.mu
        lifted = self.scaling.apply(cones.divide(self.scaling.apply(self.iterate.y), target))
        lifted = tree_axpy(1.0, lifted, self.iterate.s)
        solution = self._solve(*self._right_side(r, 1.0 - sigma, lifted))
        return self._direction(r, 1.0 - sigma, target_tau, solution, lifted)

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """How far it stays in the cones, at most one: with variables and slacks, and with multipliers. Of a linear
        program the multipliers' residuals do not depend on the variables, and both go as far as they can."""
        point = self.iterate
        primal = jnp.minimum(1.0, cones.longest_step(point.s, direction.s))
        dual = jnp.minimum(1.0, cones.longest_step(point.y, direction.y))
        both, linear = jnp.minimum(primal, dual), jnp.all(self.program.hessian == 0.0)
        return jnp.where(linear, primal, both), jnp.where(linear, dual, both)

    def centring(self, affine: Iterate) -> Scalar:
        """Mehrotra's share of the complementarity to aim at: the cube of what the affine direction leaves of it."""
        primal, dual = self.longest_steps(affine)
        s, y = tree_axpy(primal, affine.s, self.iterate.s), tree_axpy(dual, affine.y, self.iterate.y)
        return jnp.clip(tree_dot(s, y) / tree_dot(self.iterate.s, self.iterate.y), 0.0, 1.0) ** 3

    def _solve_affine(self, right_side: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        return self._solve(*right_side)

    def _right_side(
        self, r: Residuals, share: Scalar | float, lifted: ConeVector
    ) -> tuple[Primal, ConeVector]:
        """Residuals reduced by ``share``, slacks moved by ``-lifted``."""
        return jax.tree.map(lambda v: -share * v, r.x), tree_axpy(-share, r.y, lifted)

    def _direction(self, r: Residuals, share, target_tau, solution, lifted: ConeVector) -> Iterate:
        """With the slacks that follow."""
        dx, dy, dtau, dkappa = self._embed(r, share, target_tau, *solution)
        return Iterate(dx, dy, _negated(tree_axpy(1.0, lifted, self.scaling.square(dy))), dtau, dkappa)

    def _embed(self, r: Residuals, share, target_tau, x: Primal, y: ConeVector):
        """A solution as it is, where tau is one."""
        return x, y, jnp.zeros(()), jnp.zeros(())


class _Embedded(_Newton):
    """Newton directions of the embedding."""

    part = 0.99

    def longest_steps(self, direction: Iterate) -> tuple[Scalar, Scalar]:
        """One for both: residuals are in proportion to tau."""
        step = _longest_step(self.iterate, direction)
        return step, step

    def centring(self, affine: Iterate) -> Scalar:
        """That of all residuals, in proportion to tau: the cube of what the affine direction leaves of them."""
        return (1.0 - _longest_step(self.iterate, affine)) ** 3

    def _solve_affine(self, right_side: tuple[Primal, ConeVector]) -> tuple[Primal, ConeVector]:
        """Together with the constant direction, which both steps share."""
        self.q, self.b = kkt.linear_cost(self.program), kkt.right_side(self.program)
        self.xi = jax.tree.map(lambda v: v / self.iterate.tau, self.iterate.x)
        self.gradient = tree_axpy(2.0, kkt.times_hessian(self.program, self.xi), self.q)
        both = jax.tree.map(lambda u, v: jnp.stack([u, v]), (_negated(self.q), self.b), right_side)
        both = jax.vmap(self._solve)(*both)
        self.constant, solution = (jax.tree.map(lambda v, i=i: v[i], both) for i in range(2))
        self.slope = self._slope()
        return solution

    def _embed(self, r: Residuals, share, target_tau, x: Primal, y: ConeVector):
        """With the multiple of the constant direction that the embedding's last equation asks for."""
        tau, kappa = self.iterate.tau, self.iterate.kappa
        defect = -share * r.tau + target_tau / tau - tree_dot(self.gradient, x) - tree_dot(self.b, y)
        dtau = defect / self.slope
        dx, dy = tree_axpy(dtau, self.constant[0], x), tree_axpy(dtau, self.constant[1], y)
        return dx, dy, dtau, -(target_tau + kappa * dtau) / tau

    def _slope(self) -> Scalar:
        """Derivative of the embedding's last equation along the constant direction; always negative."""
        x, y = self.constant
        apart = tree_axpy(-1.0, self.xi, x)
        curvature = tree_dot(apart, kkt.times_hessian(self.program, apart))
        spread = tree_dot(y, self.scaling.square(y))
        return -(curvature + spread + self.iterate.kappa / self.iterate.tau)


def _started(program: StagedProgram, scales: Scales, iterate: Iterate) -> Progress:
    residuals = _residuals(program, scales, iterate)
    none, false = jnp.zeros((), int), jnp.zeros((), bool)
    return Progress(iterate, residuals, none, false, ~jnp.isfinite(residuals.error))


def _residuals(program: StagedProgram, scales: Scales, p: Iterate) -> Residuals:
    """What is missing at an iterate."""
    q, b = kkt.linear_cost(program), kkt.right_side(program)
    dual = tree_axpy(1.0, kkt.times_hessian(program, p.x), kkt.times_constraints_transpose(program, p.y))
    primal = tree_axpy(1.0, p.s, kkt.times_constraints(program, p.x))
    return _measured(program, scales, p, tree_axpy(p.tau, q, dual), tree_axpy(-p.tau, b, primal))


def _measured(program: StagedProgram, scales: Scales, p: Iterate, rx: Primal, ry: ConeVector) -> Residuals:
    """Of P x + A'y + tau q and A x + s - tau b, the measures."""
    q, b = kkt.linear_cost(program), kkt.right_side(program)
    hessian_x = kkt.times_hessian(program, p.x)
    dual = jax.tree.map(lambda r, a, d: r - a - p.tau * d, rx, hessian_x, q)
    primal = tree_axpy(p.tau, b, ry)
    quadratic, linear, offset = tree_dot(p.x, hessian_x), tree_dot(q, p.x), tree_dot(b, p.y)
    rtau = linear + offset + p.kappa + quadratic / p.tau
    mu = (tree_dot(p.s, p.y) + p.tau * p.kappa) / (cones.degree(p.s) + 1)

    primal_cost = (0.5 * quadratic / p.tau + linear) / p.tau
    dual_cost = (-0.5 * quadratic / p.tau - offset) / p.tau
    # The gap is judged in the user's unit of cost, the residuals in equilibrated units.
    gap = jnp.abs(primal_cost - dual_cost) / jnp.maximum(
        scales.cost, jnp.minimum(jnp.abs(primal_cost), jnp.abs(dual_cost))
    )
    primal_error = tree_max(ry) / (p.tau * jnp.maximum(1.0, tree_max(b)))
    dual_error = tree_max(rx) / (p.tau * jnp.maximum(1.0, tree_max(q)))

    infeasible = tree_max(dual) / jnp.maximum(-offset, 1e-300)
    unbounded = jnp.maximum(tree_max(hessian_x), tree_max(primal)) / jnp.maximum(-linear, 1e-300)
    return Residuals(
        rx, ry, rtau, mu, jnp.maximum(gap, jnp.maximum(primal_error, dual_error)), infeasible, unbounded
    )


def _negated(v):
    return jax.tree.map(jnp.negative, v)


def _interior_unit(program: StagedProgram) -> ConeVector:
    return cones.identity(kkt.right_side(program))


def _longest_step(point: Iterate, direction: Iterate) -> Scalar:
    def scalar_step(value, change):
        return jnp.where(change < 0, -value / change, jnp.inf)

    steps = [
        cones.longest_step(point.s, direction.s),
        cones.longest_step(point.y, direction.y),
        scalar_step(point.tau, direction.tau),
        scalar_step(point.kappa, direction.kappa),
        jnp.ones(()),
    ]
    return jnp.min(jnp.stack(steps))
