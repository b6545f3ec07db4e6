"""Sequential convex programming with second derivatives: its limit points are local optima, safe between nodes.

An iteration has five parts, each in a file of its name:

- ``convex_model``: the cost, with a convexified Hessian and a proximal term;
- ``subproblem``: the convex program, with path constraints inside every interval, solved;
- ``line_search``: fractions of the step, each with a second-order correction, until an augmented Lagrangian falls below
  the worst of the last few points;
- ``acceptance``: the step is accepted if it did, or if the predicted decrease is rounding; then the proximal weight;
- ``convergence``: the optimality conditions, tested.

At the end an interior point on the nonlinear problem goes on to the optimum.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.serving import Backends
from jaxscp.conic.program import ConicMultipliers, served_by
from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Count, Flag, Nodes, Scalar
from jaxscp.nlp.central_path import Point
from jaxscp.nlp.sensitivity import implicit_solution
from jaxscp.problem.form import Continuous, Form
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp import mesh
from jaxscp.scp.acceptance import accept_or_reject
from jaxscp.scp.active_set import near_limits
from jaxscp.scp.convergence import check_convergence
from jaxscp.scp.convex_model import convex_model
from jaxscp.scp.history import History
from jaxscp.scp.interval_subproblem import check
from jaxscp.scp.line_search import line_search
from jaxscp.scp.method import MethodResult
from jaxscp.scp.second_order_correction import corrected, correction
from jaxscp.scp.state import NewtonSettings, NewtonState
from jaxscp.scp.subproblem import program_like, solve_subproblem
from jaxscp.transcription import shooting
from jaxscp.transcription.lagrangian import no_multipliers, residual
from jaxscp.transcription.layout import stage_sizes
from jaxscp.transcription.shooting import evaluate, linearise, linearise_with_hessian, total_cost

TOLERANCE_FACTORS = (1000.0, 1.0)  # times the tolerances, at which the interior point is tried
BARRIER_OF_STEP = (
    1e-2  # first barrier of the interior point, over the square of the last step, in typical sizes
)
# The interior point's mesh is free first. Many plans cost nearly the same on other meshes: along such directions it may
# go on for long. Then the dilation of each node keeps within this factor. A good mesh is kept first, and free then.
MESH_RATIOS = jnp.inf, 1.3
SAME_TIME = 1.05  # ratio of flight times, up to which a good mesh still is one
MERIT_MEMORY = 5  # accepted points whose worst merit a new one must beat
# On leaving a limit, one round each; the last one is lower: a limit may be left where nothing else helps.
RESTORATION_PENALTIES = (1e7, 1e7, 1e7, 1e4)


class _Optimum(eqx.Module):
    """The optimum that the interior point found, or else the point where it began."""

    z: Float[Array, "nodes variables"]
    multipliers: Multipliers
    least: Nodes
    """Bounds of each node's dilation."""
    most: Nodes
    found: Flag
    steps: Count


class NewtonSCP(NewtonSettings):
    """Sequential convex programming with second derivatives, and an interior point at the end.

    Args:
        tolerance: decrease of the cost, relative to it, that the model of a converged iterate may still predict.
        tolerance_defect: for a converged iterate, sum of |F(w_i) - x_{i+1}| over the intervals and of both ends'
            residuals, and worst violation of a constraint at its points; ``restore_dynamics`` removes the rest.
        tolerance_gradient: KKT residual (``stationarity``) of a converged iterate.
        max_iterations: subproblems allowed.
        initial_forcing: relative accuracy of the first subproblem. Each is solved ten times better than the one before,
            down to the solver's tolerance. Zero solves all to that, in more Newton steps.
        proximal: first weight of the squared (scaled) step.
        virtual_weight: penalty weight of virtual control.
        merit_weight: of squared residuals in the augmented Lagrangian; the multipliers do most of its work.
        correction_rounds: of the second-order correction, each a linear solve.
        grid: of integration and path constraints.
        interior: the interior point on the nonlinear problem.
        conic: solver of the subproblems.

    Example:
        >>> import jaxscp
        >>> planner = jaxscp.Planner(nodes=20, method=jaxscp.NewtonSCP())  # the default
        >>> solution = planner(jaxscp.scenarios.ascent_to_platform())
        >>> jaxscp.status_names(solution.status), bool(solution.certificate.violation < 1e-2)
        ('converged', True)
    """

    @property
    def form(self) -> Form:
        """As few states as the problem needs, and constraints between the nodes too."""
        return Continuous()

    @property
    def holds_between_nodes(self) -> bool:
        """True."""
        return True

    def result(self, problem: ScaledTimeProblem, state: NewtonState) -> MethodResult:
        """Result of the last state, with derivatives by the implicit function theorem."""
        problem = mesh.bounded(problem, state.dilation_most, state.dilation_least)
        point = implicit_solution(problem, Point(state.z, state.multipliers), self.grid, state.is_optimum)
        cost = total_cost(problem, point.z, evaluate(problem, point.z, self.grid))
        program = program_like(problem, state.z, state.linear)
        backends = Backends(shooting.served_by(problem, state.z, self.grid), served_by(self.conic, program))
        return MethodResult(
            z=point.z,
            cost=cost,
            multipliers=point.y,
            is_optimum=state.is_optimum,
            interior_point_iterations=state.interior_point_iterations,
            iterations=state.iterations,
            status=state.status,
            history=state.history,
            backends=backends,
        )

    def init(self, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]) -> NewtonState:
        """State before the first subproblem, from a guess."""
        check(problem)
        multipliers = no_multipliers(problem, z, self.grid)
        linear, hessian = linearise_with_hessian(problem, z, multipliers, self.grid)
        now = residual(problem, z, linear.outputs)
        count, no = jnp.zeros((), int), jnp.zeros((), bool)
        return NewtonState(
            z=z,
            linear=linear,
            hessian=hessian,
            multipliers=multipliers,
            conic_multipliers=ConicMultipliers.zeros(program_like(problem, z, linear)),
            merit_history=jax.tree.map(lambda v: jnp.broadcast_to(v, (MERIT_MEMORY, *v.shape)), now),
            proximal=jnp.asarray(self.proximal, z.dtype),
            full_hessian=no,
            scale=typical_sizes(z),
            accepted_with_small_proximal=no,
            cost=now.cost,
            iterations=count,
            close_to_optimum=no,
            is_optimum=no,
            interior_point_iterations=count,
            status=Status.iteration_limit,
            done=no,
            history=History.zeros(self.max_iterations, z.dtype),
            dilation_least=jnp.zeros(z.shape[0], z.dtype),
            dilation_most=jnp.full(z.shape[0], jnp.inf, z.dtype),
        )

    def step(
        self, problem: ScaledTimeProblem, state: NewtonState, tolerance_factor: Scalar | float = 1.0
    ) -> NewtonState:
        """One iteration; the loop may end where ``tolerance_factor`` times the tolerances are met."""
        model = convex_model(problem, state)
        qp = solve_subproblem(self, problem, state, model, self.terminate(state))
        search = line_search(self, problem, state, model, qp)
        new = accept_or_reject(self, problem, state, qp, search)
        return check_convergence(self, problem, new, qp, tolerance_factor)

    def terminate(self, state: NewtonState) -> Flag:
        """Whether the loop is over."""
        return state.done | (state.iterations >= self.max_iterations)

    def on_the_way(self, state: NewtonState) -> Flag:
        """Whether the limit of the iterations ended a way on which the subproblems could be solved."""
        most = self.max_iterations
        solved = state.history.virtual_control[most - 1] <= self.tolerance_defect
        return (state.iterations == most) & solved & (state.status != Status.converged)

    def run(
        self,
        problem: ScaledTimeProblem,
        z: Float[Array, "nodes variables"],
        enabled: Flag | bool = True,
        keep_mesh: Flag | bool = False,
    ) -> NewtonState:
        """Iterate from a guess to the optimum; a batch element that is not enabled takes no step.

        The subproblems lead near the optimum, and the interior point from there to it. Where it fails, the
        subproblems go on to convergence. With ``keep_mesh``, the interior point first stays near the subproblems' mesh.
        """
        start = batching.in_chunks(lambda fixed: self.init(*fixed), (problem, z))
        start = eqx.tree_at(lambda s: s.done, start, ~jnp.asarray(enabled))
        usual_dilation = jnp.where(keep_mesh, jnp.mean(z[:, -1]), 0.0)

        def attempt(state, tolerance_factor):
            state = batching.while_loop(
                lambda s: ~self.terminate(s),
                lambda fixed, s: self.step(fixed[0], s, fixed[1]),
                (problem, tolerance_factor),
                state,
                batching.CHUNK_OF_SUBPROBLEMS,
            )
            return self.switch_to_interior_point(problem, state, usual_dilation), None

        end, _ = jax.lax.scan(attempt, start, jnp.array(TOLERANCE_FACTORS))
        restore = lambda problem, state, _: self.restore_dynamics(problem, state)  # noqa: E731
        return batching.where_needed(~end.is_optimum, restore, problem, end)

    def switch_to_interior_point(
        self, problem: ScaledTimeProblem, state: NewtonState, usual_dilation: Scalar
    ) -> NewtonState:
        """The optimum close to the last iterate, if the interior point finds it; else the state as it is."""
        found = self._interior_optimum(problem, state, usual_dilation)
        z, is_optimum = found.z, found.found
        cost = jnp.sum(evaluate(problem, z, self.grid).cost) + problem.terminal_cost(z)
        return eqx.tree_at(
            lambda s: (
                s.z,
                s.multipliers,
                s.cost,
                s.status,
                s.is_optimum,
                s.close_to_optimum,
                s.done,
                s.interior_point_iterations,
                s.dilation_least,
                s.dilation_most,
            ),
            state,
            (
                z,
                found.multipliers,
                jnp.where(is_optimum, cost, state.cost),
                Status.where(is_optimum, Status.converged, state.status),
                is_optimum | state.is_optimum,
                jnp.zeros((), bool),
                state.done & (is_optimum | ~state.close_to_optimum),
                state.interior_point_iterations + found.steps,
                found.least,
                found.most,
            ),
        )

    def _interior_optimum(
        self, problem: ScaledTimeProblem, state: NewtonState, usual_dilation: Scalar
    ) -> _Optimum:
        """By the interior point: on a free mesh, and else on one near the last iterate's.

        The other way round, if the flight takes the time of a guess with a good mesh (zero if there is none).
        """
        # A high barrier would lead a point that is an optimum away from it, and perhaps to another one.
        last = state.history.step_norm[jnp.maximum(state.iterations - 1, 0)]
        mu = jnp.clip(BARRIER_OF_STEP * last**2, self.interior.final_mu, self.interior.initial_mu)

        def run(fixed, found: _Optimum, needed: Flag) -> _Optimum:
            mu, problem, z, multipliers, least, most = fixed
            interior = eqx.tree_at(lambda i: i.initial_mu, self.interior, mu)
            end = interior.run(mesh.bounded(problem, most, least), z, multipliers, self.grid, needed)
            is_optimum, steps = interior.is_optimum(end), found.steps + end.steps
            new = _Optimum(end.z, end.y, least, most, is_optimum, steps)
            found = eqx.tree_at(lambda f: f.steps, found, steps)
            return tree_where(is_optimum, new, found)

        def attempt(found: _Optimum, bounds):
            fixed = (mu, problem, state.z, state.multipliers, *bounds)
            return batching.where_needed(state.close_to_optimum & ~found.found, run, fixed, found), None

        dilation, none = state.z[:, -1], jnp.zeros((), int)
        longer = jnp.mean(dilation) / usual_dilation
        keep_mesh = jnp.maximum(longer, 1.0 / longer) <= SAME_TIME
        ratios = jnp.where(keep_mesh, jnp.array(MESH_RATIOS[::-1]), jnp.array(MESH_RATIOS))[:, None]
        as_it_is = state.z, state.multipliers, state.dilation_least, state.dilation_most
        begun = _Optimum(*as_it_is, jnp.zeros((), bool), none)
        return jax.lax.scan(attempt, begun, (dilation / ratios, dilation * ratios))[0]

    def restore_dynamics(self, problem: ScaledTimeProblem, state: NewtonState) -> NewtonState:
        """Reduce the remaining defects and end residuals by Newton's method, with a penalty on leaving limits.

        The last round has a lower penalty: with too many conditions near a limit, the dynamics need some slack.
        """
        sizes = stage_sizes(problem, state.scale)
        inputs = sizes.shape[0]
        # The least change in the plain norm: after an early stop, the multipliers may be far from the point's own.
        metric = jnp.broadcast_to(jnp.eye(inputs), (problem.nodes - 1, inputs, inputs))

        def one_round(carry, penalty):
            z, linear = carry
            active = near_limits(problem, linear, z, sizes)
            by = correction(problem, linear, active, metric, state.scale, penalty)
            z = corrected(problem, z, by, self.grid, self.correction_rounds)
            return (z, linearise(problem, z, self.grid)), None

        (z, linear), _ = jax.lax.scan(one_round, (state.z, state.linear), jnp.array(RESTORATION_PENALTIES))
        now = residual(problem, z, linear.outputs)
        return eqx.tree_at(lambda s: (s.z, s.linear, s.cost), state, (z, linear, now.cost))
