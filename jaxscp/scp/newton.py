"""Sequential convex programming with second derivatives: its limit points are local optima, safe between nodes.

Each iteration poses the subproblem with the curvature of the Lagrangian made convex (``curvature``), a quadratic
proximal term, and the path constraints at points inside every interval (``intervals``); corrects the step to
second order (``correction``); and takes it if an augmented Lagrangian falls below the worst of the last few
(``lagrangian``). The proximal weight follows how well the model (``model``) foretold the merit.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, ConicSolver, WarmStart
from jaxscp.core import batching
from jaxscp.core.status import Status, usable
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.nlp.central_path import Point
from jaxscp.nlp.interior_point import NLPInteriorPoint
from jaxscp.nlp.sensitivity import implicit_solution
from jaxscp.problem.problem import OptimalControlProblem, node_times, terminal_cost, typical_sizes
from jaxscp.scp.active_set import active_set, near_limits, slacks
from jaxscp.scp.convex_model import convex_model, foretold, scaled_hessian
from jaxscp.scp.hessian_convexification import projected
from jaxscp.scp.history import History
from jaxscp.scp.line_search import Merit, Step, search
from jaxscp.scp.method import End, MethodResult
from jaxscp.scp.second_order_correction import corrected, correction
from jaxscp.scp.state import NewtonState
from jaxscp.scp.subproblem import check as check_liftable
from jaxscp.scp.subproblem import flight_multipliers, lifted_program, node_step
from jaxscp.transcription.lagrangian import no_multipliers, residual, worst_violation
from jaxscp.transcription.layout import cost_gradient, stage_sizes
from jaxscp.transcription.shooting import Grid, Linearisation, evaluate, linearise, linearise_with_hessian
from jaxscp.transcription.stationarity import lagrangian_gradient, stationarity
from jaxscp.verification.gradient import reflown_gradient

SHORTENED = (
    1.0,
    2.0,
    4.0,
)  # factors, at least, by which the proximal weight grows where less of a step is taken
FIRMNESS = (1e7, 1e7, 1e7, 1e4)  # prices of leaving a limit, at the end: so much leaves nothing to see
SLACK = (100.0, 1.0)  # times the tolerances, at which the interior point is tried
MEMORY = 5  # accepted points whose worst merit a new one must beat
EXACT_BELOW = 1e-3  # proximal weight from which on curvature is condensed
EXACT_PROXIMAL = 0.02  # proximal weight to begin that with
TIGHTER = 0.1  # times as accurate, from a subproblem to the next
ROUNDING = 1e-7  # of the cost: what subproblems of this accuracy leave unsure
LEAST_PROXIMAL, MOST_PROXIMAL = 1e-5, 1e4


class NewtonSCP(eqx.Module):
    """Settings of the method.

    Args:
        tolerance: decrease of the cost, relative to it, that the model of a converged iterate still foretells.
        tolerance_defect: sum of |F(w_i) - x_{i+1}| over the intervals of a converged iterate, and worst violation
            of a constraint at its points; what is left is closed at the end.
        tolerance_gradient: residual of the optimality conditions (``stationarity``) of a converged iterate.
        max_iterations: subproblems allowed.
        coarsest: relative accuracy of the first subproblem; each is solved ten times better than the one before, down
            to the solver's tolerance. Zero solves all to that, in more Newton steps.
        proximal: first weight of the squared (scaled) step.
        virtual_weight: price of virtual control.
        merit_weight: of squared residuals in the augmented Lagrangian; the multipliers do most of its work.
        correction_rounds: of the second-order correction, each a linear solve.
        grid: of integration and path constraints.
        interior: the method of the end.
        conic: solver of the subproblems.

    Example:
        >>> import jaxscp
        >>> planner = jaxscp.Planner(nodes=20, method=jaxscp.NewtonSCP())  # the default
        >>> solution = planner(jaxscp.scenarios.ascent_to_platform())
        >>> jaxscp.status_names(solution.status), bool(solution.certificate.violation < 1e-2)
        ('converged', True)
    """

    tolerance: float = 1e-4
    tolerance_defect: float = 5e-3
    tolerance_gradient: float = 0.1
    max_iterations: int = eqx.field(default=60, static=True)
    coarsest: float = 1e-2
    proximal: float = 0.1
    virtual_weight: float = 1000.0
    merit_weight: float = 10.0
    correction_rounds: int = eqx.field(default=2, static=True)
    grid: Grid = Grid()
    interior: NLPInteriorPoint = NLPInteriorPoint()
    conic: ConicSolver = InteriorPoint(tolerance=1e-7)

    @property
    def published(self) -> bool:
        """Whether the landing problem is stated as in the paper."""
        return False

    @property
    def holds_between_nodes(self) -> bool:
        """Whether a converged answer claims to keep its constraints between the nodes too."""
        return True

    def answer(self, problem: OptimalControlProblem, state: NewtonState) -> MethodResult:
        """The end, as a function of the problem."""
        point = implicit_solution(problem, Point(state.z, state.multipliers), self.grid, state.reached)
        cost = jnp.sum(evaluate(problem, point.z, self.grid).cost) + terminal_cost(problem, point.z)
        return MethodResult(point.z, cost, point.y, state.reached, state.newton_steps)

    def optimality(self, problem: OptimalControlProblem, end: End) -> Scalar:
        """How far the end is from a point of Karush, Kuhn and Tucker, by the judge's own flight."""
        assert end.multipliers is not None  # for type checkers
        gradient = reflown_gradient(problem, end.z, end.multipliers, self.grid)
        return stationarity(gradient, end.z, end.cost)

    def init(self, problem: OptimalControlProblem, z: Float[Array, "nodes variables"]) -> NewtonState:
        """State before the first subproblem, from an initial guess."""
        check_liftable(problem)
        free = no_multipliers(problem, z, self.grid)
        linear, curvature = linearise_with_hessian(problem, z, free, self.grid)
        zeros, counts = jnp.zeros(self.max_iterations, z.dtype), jnp.zeros(self.max_iterations, int)
        now = residual(linear.outputs, terminal_cost(problem, z), z)
        return NewtonState(
            z=z,
            linear=linear,
            curvature=curvature,
            multipliers=free,
            prices=_no_prices(problem, z, linear),
            past=jax.tree.map(lambda v: jnp.broadcast_to(v, (MEMORY, *v.shape)), now),
            proximal=jnp.asarray(self.proximal, z.dtype),
            exact=jnp.zeros((), bool),
            scale=typical_sizes(z),
            cost=now.cost,
            iterations=jnp.zeros((), int),
            near=jnp.zeros((), bool),
            reached=jnp.zeros((), bool),
            newton_steps=jnp.zeros((), int),
            status=Status.iteration_limit,
            done=jnp.zeros((), bool),
            history=History(zeros, zeros, zeros, zeros, zeros, zeros, counts),
        )

    def step(
        self, problem: OptimalControlProblem, state: NewtonState, slack: Scalar | float = 1.0
    ) -> NewtonState:
        """Solve one subproblem; take its answer, corrected, if the merit agrees. Where ``slack`` times the tolerances
        are met, the loop may end."""
        scale = stage_sizes(problem, state.scale)
        now = jax.tree.map(lambda v: v[0], state.past)
        clipped = projected(scaled_hessian(state.curvature, scale))
        hessian, gradient = convex_model(problem, state, now, clipped, scale)
        program = lifted_program(problem, state.z, state.linear, hessian, gradient, self.virtual_weight)
        near = WarmStart(jnp.zeros_like(program.gradient), state.prices, state.iterations > 0)
        # a lane that has ended fills up a batch, and asks for nothing
        accuracy = jnp.where(self.terminate(state), jnp.inf, self.accuracy(state))
        solution = self.conic(program, accuracy, near)

        multipliers = flight_multipliers(problem, state.linear, solution.multipliers)
        move = node_step(problem, solution.z)
        held = active_set(problem, state.linear, multipliers, scale)
        virtual = program.virtual_control(solution.z)[1:-1, : problem.state_size]
        slope = jnp.vdot(
            cost_gradient(problem, state.z, state.linear.jacobian.cost), solution.z[:, : scale.shape[0]]
        )
        expected = foretold(problem, now, slope, state.curvature, solution.z, move, virtual)

        judge = Merit(problem, multipliers, self.merit_weight, state.scale[: problem.state_size])
        gain = judge(now) - judge(expected)
        settled = jnp.abs(gain) <= ROUNDING * (1.0 + jnp.abs(now.cost))
        step = Step(
            z=state.z,
            move=move,
            room=slacks(problem, state.linear.outputs),
            correction=correction(problem, state.linear, held, clipped.hessian, state.scale),
            merit=judge,
            enough=jnp.max(jax.vmap(judge)(state.past)) - 1e-4 * jnp.abs(gain),
            grid=self.grid,
            rounds=self.correction_rounds,
        )
        found = search(step, now)
        candidate, new = found.trial.z, found.trial.residual
        linear, curvature = linearise_with_hessian(problem, candidate, multipliers, self.grid)

        ratio = jnp.where(settled, 1.0, (judge(now) - found.whole.merit) / jnp.maximum(jnp.abs(gain), 1e-12))
        found_all, _ = ravel_pytree((new, linear, curvature, multipliers))
        good = usable(solution.status) & jnp.all(jnp.isfinite(found_all))
        accept = good & (found.good | settled)

        proximal, exact = _adapted(state, ratio, accept, found.chosen)
        past = jax.tree.map(lambda p, v: jnp.concatenate([v[None], p[:-1]]), state.past, new)
        z, past, kept_linear, kept_curvature, kept_multipliers, prices = jax.lax.cond(
            accept,
            lambda taken, _: taken,
            lambda _, kept: kept,
            (candidate, past, linear, curvature, multipliers, solution.multipliers),
            (state.z, state.past, state.linear, state.curvature, state.multipliers, state.prices),
        )
        now = jax.tree.map(lambda v: v[0], past)
        defects = jnp.linalg.norm(now.defect, axis=1)
        lacks = jnp.stack([jnp.sum(defects), worst_violation(problem, now)]) / self.tolerance_defect
        flown, safe = lacks <= 1.0
        closed = flown & safe
        small = jnp.abs(gain) / (self.tolerance * jnp.maximum(1.0, jnp.abs(now.cost)))
        gradient = lagrangian_gradient(problem, candidate, linear, multipliers)
        flat = stationarity(gradient, candidate, now.cost) / self.tolerance_gradient
        rough = accuracy / self.tolerance  # what a coarse subproblem leaves unsure
        worst = jnp.max(jnp.stack([*lacks, small, flat, rough]))  # in tolerances
        settling = accept & (state.proximal <= EXACT_PROXIMAL)
        optimal, near = settling & (worst <= 1.0), settling & (worst <= slack)
        stuck = proximal > MOST_PROXIMAL
        status = Status.where(safe, Status.iteration_limit, Status.constraints_unmet)
        status = Status.where(flown, status, Status.dynamics_unmet)
        status = Status.where(stuck & closed, Status.insufficient_progress, status)
        status = Status.where(stuck & ~usable(solution.status), solution.status, status)
        row = History(
            cost=now.cost,
            objective=solution.objective,
            final_time=node_times(z[:, -1])[-1],
            virtual=jnp.max(jnp.linalg.norm(virtual, axis=1)),
            step=jnp.max(jnp.linalg.norm(move / state.scale, axis=1)),
            defect=jnp.max(defects),
            conic_iterations=solution.iterations,
        )
        return NewtonState(
            z=z,
            linear=kept_linear,
            curvature=kept_curvature,
            multipliers=kept_multipliers,
            prices=prices,
            past=past,
            proximal=proximal,
            exact=exact,
            scale=jnp.maximum(state.scale, typical_sizes(z)),
            cost=now.cost,
            iterations=state.iterations + 1,
            near=near,
            reached=state.reached,
            newton_steps=state.newton_steps,
            status=Status.where(optimal, Status.converged, status),
            done=near | stuck,
            history=jax.tree.map(lambda h, v: h.at[state.iterations].set(v), state.history, row),
        )

    def accuracy(self, state: NewtonState) -> Scalar:
        """Relative accuracy that the next subproblem is worth: early ones are of a model that is soon another."""
        return self.coarsest * TIGHTER ** state.iterations.astype(state.cost.dtype)

    def terminate(self, state: NewtonState) -> Flag:
        """Whether the loop is over."""
        return state.done | (state.iterations >= self.max_iterations)

    def run(
        self, problem: OptimalControlProblem, z: Float[Array, "nodes variables"], wanted: Flag | bool = True
    ) -> NewtonState:
        """Iterate from an initial guess to the optimum; not at all for a lane that is not wanted.

        The subproblems lead near the optimum, and the interior point from there to it. Where it fails, the
        subproblems go on to an end of their own, closer by.
        """
        start = batching.in_tiles(lambda fixed: self.init(*fixed), (problem, z))
        start = eqx.tree_at(lambda s: s.done, start, ~jnp.asarray(wanted))

        def attempt(state, slack):
            state = batching.while_loop(
                lambda s: ~self.terminate(s),
                lambda fixed, s: self.step(fixed[0], s, fixed[1]),
                (problem, slack),
                state,
            )
            return self.finish(problem, state), None

        end, _ = jax.lax.scan(attempt, start, jnp.array(SLACK))
        return batching.where_needed(~end.reached, self.polish, problem, end)

    def finish(self, problem: OptimalControlProblem, state: NewtonState) -> NewtonState:
        """The optimum that the iterates are near, if Newton's method gets there from here."""
        found = self.interior.run(problem, state.z, state.multipliers, self.grid, state.near)
        there = state.near & self.interior.reached(found)
        z, multipliers = jax.tree.map(
            lambda a, b: jnp.where(there, a, b), (found.z, found.y), (state.z, state.multipliers)
        )
        cost = jnp.sum(evaluate(problem, z, self.grid).cost) + terminal_cost(problem, z)
        return eqx.tree_at(
            lambda s: (s.z, s.multipliers, s.cost, s.status, s.reached, s.near, s.done, s.newton_steps),
            state,
            (
                z,
                multipliers,
                jnp.where(there, cost, state.cost),
                Status.where(there, Status.converged, state.status),
                there | state.reached,
                jnp.zeros((), bool),
                state.done & (there | ~state.near),
                state.newton_steps + found.steps,
            ),
        )

    def polish(self, problem: OptimalControlProblem, state: NewtonState) -> NewtonState:
        """Close what is left of the defects by Newton's method on them, without using up what is near a limit. Where
        too much is near a limit for that, the last rounds may use up some."""
        sizes = stage_sizes(problem, state.scale)
        inputs = sizes.shape[0]
        # Plain least change: the multipliers may be far from those of the point, if the loop was cut short.
        metric = jnp.broadcast_to(jnp.eye(inputs), (problem.nodes - 1, inputs, inputs))

        def one_round(carry, firmness):
            z, linear = carry
            near = near_limits(problem, linear, z, sizes)
            by = correction(problem, linear, near, metric, state.scale, firmness)
            z = corrected(problem, z, by, self.grid, self.correction_rounds)
            return (z, linearise(problem, z, self.grid)), None

        (z, linear), _ = jax.lax.scan(one_round, (state.z, state.linear), jnp.array(FIRMNESS))
        now = residual(linear.outputs, terminal_cost(problem, z), z)
        return eqx.tree_at(lambda s: (s.z, s.linear, s.cost), state, (z, linear, now.cost))


def _no_prices(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], linear: Linearisation
) -> ConicMultipliers:
    """Of a subproblem's rows, none of them active."""
    inputs = stage_sizes(problem, z[0]).shape[0]
    like = lambda *shape: jax.ShapeDtypeStruct((problem.nodes, *shape), z.dtype)  # noqa: E731
    program = jax.eval_shape(
        lambda hessian, gradient: lifted_program(problem, z, linear, hessian, gradient, 1.0),
        like(inputs, inputs),
        like(inputs),
    )
    return ConicMultipliers.zeros(program)


def _adapted(state: NewtonState, ratio: Scalar, accept: Flag, chosen: Count):
    """Next proximal weight, and whether curvature is to be condensed.

    Args:
        state: before the step.
        ratio: of what the whole step gained and what the model foretold.
        accept: whether any part of the step was taken.
        chosen: which part.
    """
    rough = jnp.where(ratio > 0.5, 0.2, jnp.where(ratio > 0.1, 1.0, 2.0))
    fine = jnp.where(ratio > 0.85, 0.2, jnp.where(ratio > 0.6, 0.5, jnp.where(ratio > 0.2, 1.0, 3.0)))
    factor = jnp.where(state.exact, fine, rough)
    factor = jnp.where(chosen > 0, jnp.maximum(factor, jnp.array(SHORTENED)[chosen]), factor)
    factor = jnp.where(accept, factor, jnp.where(state.exact, 5.0, 8.0))
    proximal = jnp.maximum(state.proximal * factor, LEAST_PROXIMAL)
    begin = accept & ~state.exact & (proximal < EXACT_BELOW) & (ratio > 0.5)
    return jnp.where(begin, EXACT_PROXIMAL, proximal), state.exact | begin
