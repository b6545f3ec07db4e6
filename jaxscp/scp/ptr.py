"""Sequential convex programming with a penalised trust region (Algorithm 1): linearise, solve, repeat.

``init``, ``step`` and ``terminate`` are pure functions of arrays; ``run`` is the loop over them, written once.
Under ``vmap`` a batch element that has ended does not change while others go on.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.serving import Backends
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, ConicSolver, WarmStart, served_by
from jaxscp.core import batching
from jaxscp.core.status import Status, StatusCode, after_failed_subproblem, usable
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.nlp.sensitivity import without_derivative
from jaxscp.problem.form import Form, Paper
from jaxscp.problem.node_values import node_times
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.history import History
from jaxscp.scp.method import MethodResult
from jaxscp.scp.nodal_subproblem import NormTrustRegion, TrustRegion, nodal_subproblem
from jaxscp.transcription import discretise
from jaxscp.transcription.discretise import Discretisation

STAGNATION = 0.99  # ratio of virtual control, from a subproblem to the next, at which it does not vanish
FORCING_FACTOR = 0.3  # of the accuracy, where steps do not shrink: inexact solutions can cause that
FORCING_OF_STEP = 7e-3  # accuracy of a subproblem, relative to the square of the last step
FINAL_FORCING = 5e-5  # accuracy that a converged subproblem needs; a finer one is of no use
# Batch elements that a GPU steps at once; a smaller chunk would leave it idle. For the few elements that need another
# subproblem or two, a second size.
CHUNKS = 4096, 512


class PTRState(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    """The reference: the last accepted iterate."""
    flow: Discretisation
    """Linearisation of the dynamics about the reference."""
    cost: Scalar
    iterations: Count
    status: StatusCode
    done: Flag
    history: History
    multipliers: ConicMultipliers
    """Of the last subproblem."""


class PTR(eqx.Module):
    """Sequential convex programming with a penalised trust region: the paper's Table I and stopping rule by default.

    Args:
        trust_region: penalty on the distance from the reference.
        virtual_weight: penalty weight of virtual control, w_vc.
        tolerance_virtual: largest |nu_i| of a converged iterate.
        tolerance_step: largest |z_k - zref_k| of a converged iterate.
        max_iterations: subproblems allowed.
        substeps: RK4 steps an interval; never fewer than ten, since optimisers exploit the integration error of four.
        initial_forcing: relative accuracy of the first subproblem; the next are solved better and better. Zero solves
            all to the solver's tolerance, in far more Newton steps, at nearly the same cost of the plan.
        conic: solver of the subproblems, called with the accuracy needed and a warm start.
    """

    trust_region: TrustRegion = NormTrustRegion()
    virtual_weight: float = 1000.0
    tolerance_virtual: float = 1e-4
    tolerance_step: float = 1e-3
    max_iterations: int = eqx.field(default=50, static=True)
    substeps: int = eqx.field(default=10, static=True)
    initial_forcing: float = 1.0
    conic: ConicSolver = InteriorPoint(equilibration=1, refine_below=1e-5)

    @property
    def form(self) -> Form:
        """As in the paper."""
        return Paper()

    @property
    def holds_between_nodes(self) -> bool:
        """False: constraints hold at the nodes."""
        return False

    @property
    def grid(self) -> None:
        """None: constraints hold at the nodes."""
        return None

    def result(self, problem: ScaledTimeProblem, state: PTRState) -> MethodResult:
        """Result of the last state. It is not differentiable: the stopping point depends on the guess."""
        z, cost = without_derivative(state.z, problem), without_derivative(state.cost, problem)
        return MethodResult(
            z=z,
            cost=cost,
            multipliers=None,
            is_optimum=jnp.zeros((), bool),
            interior_point_iterations=jnp.zeros((), int),
            iterations=state.iterations,
            status=state.status,
            history=state.history,
            backends=Backends(
                discretise.served_by(problem, state.z, self.substeps),
                served_by(self.conic, self._program_like(problem, state.z, state.flow)),
            ),
        )

    def init(self, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]) -> PTRState:
        """State before the first subproblem, from a guess."""
        flow = discretise.discretise(problem, z, self.substeps)
        return PTRState(
            z=z,
            flow=flow,
            cost=jnp.zeros((), z.dtype),
            iterations=jnp.zeros((), int),
            status=Status.iteration_limit,
            done=jnp.zeros((), bool),
            history=History.zeros(self.max_iterations, z.dtype),
            multipliers=ConicMultipliers.zeros(self._program_like(problem, z, flow)),
        )

    def step(self, problem: ScaledTimeProblem, state: PTRState) -> PTRState:
        """Solve one subproblem; its solution is the next reference."""
        program, cost = self._program(problem, state.z, state.flow)
        # a batch element that has ended is in the chunk only to fill it
        forcing = jnp.where(self.terminate(state), jnp.inf, self.forcing_term(state))
        solution = self.conic(program, forcing, WarmStart(state.z, state.multipliers))
        good = usable(solution.status) & jnp.all(jnp.isfinite(solution.z))
        z = jnp.where(good, solution.z, state.z)
        flow = discretise.discretise(problem, z, self.substeps)
        virtual_control = jnp.max(jnp.linalg.norm(program.virtual_control(z), axis=1))
        step_norm = jnp.max(jnp.linalg.norm(z - state.z, axis=1))
        small_step = (step_norm < self.tolerance_step) & (forcing <= FINAL_FORCING)
        dynamics_feasible = virtual_control < self.tolerance_virtual
        row = History(
            cost=cost(z),
            objective=solution.objective,
            final_time=node_times(z[:, -1])[-1],
            virtual_control=virtual_control,
            step_norm=step_norm,
            defect=largest_defect(problem, z, flow),
            conic_iterations=solution.iterations,
        )
        status = Status.where(dynamics_feasible, Status.iteration_limit, Status.dynamics_unmet)
        status = Status.where(dynamics_feasible & small_step, Status.converged, status)
        return PTRState(
            z=z,
            flow=flow,
            cost=cost(z),
            iterations=state.iterations + 1,
            status=Status.where(good, status, after_failed_subproblem(solution.status)),
            done=~good | (small_step & (dynamics_feasible | _stagnates(virtual_control, state))),
            history=state.history.with_row(state.iterations, row),
            multipliers=solution.multipliers,
        )

    def forcing_term(self, state: PTRState) -> Scalar:
        """Relative accuracy of the next subproblem.

        A reference that moves far will soon change, so that its subproblem needs little accuracy. Near the end, steps
        are about the square of the last one, until they are negligible.
        """
        last = state.history.step_norm[
            state.iterations - 1
        ]  # before the first: the last row's, which is zero
        most = self.initial_forcing * FORCING_FACTOR ** state.iterations.astype(last.dtype)
        of_step = jnp.maximum(FINAL_FORCING, FORCING_OF_STEP * last**2)
        return jnp.where(state.iterations == 0, most, jnp.minimum(most, of_step))

    def _program(self, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], flow: Discretisation):
        return nodal_subproblem(problem, z, flow, self.trust_region, self.virtual_weight)

    def _program_like(
        self, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], flow: Discretisation
    ):
        return jax.eval_shape(lambda: self._program(problem, z, flow)[0])

    def terminate(self, state: PTRState) -> Flag:
        """Whether the loop is over."""
        return state.done | (state.iterations >= self.max_iterations)

    def on_the_way(self, state: PTRState) -> bool:
        """False: it is meant to stop early."""
        return False

    def run(
        self,
        problem: ScaledTimeProblem,
        z: Float[Array, "nodes variables"],
        enabled: Flag | bool = True,
        keep_mesh: Flag | bool = False,
    ) -> PTRState:
        """Iterate from a guess to the end; a batch element that is not enabled takes no step. The mesh is free."""
        start = self.init(problem, z)
        start = eqx.tree_at(lambda s: s.done, start, ~jnp.asarray(enabled))
        return batching.while_loop(lambda state: ~self.terminate(state), self.step, problem, start, CHUNKS)


def _stagnates(virtual_control: Scalar, state: PTRState) -> Flag:
    """Whether virtual control is as large as before the subproblem: a fixed point that does not vanish."""
    before = state.history.virtual_control[state.iterations - 1]
    return (state.iterations > 0) & (virtual_control > STAGNATION * before)


def largest_defect(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], flow: Discretisation
) -> Scalar:
    """Largest norm over the intervals of F(z_i) - x_{i+1}, physical states only."""
    n = problem.dynamic_states
    return jnp.max(jnp.linalg.norm(flow.state[:, :n] - z[1:, :n], axis=1))
