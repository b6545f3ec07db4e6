"""Sequential convex programming (Algorithm 1): linearise, solve the subproblem, repeat until nothing moves.

``init``, ``step`` and ``terminate`` are pure functions of arrays; ``run`` is the loop over them, written once.
Under ``vmap`` a lane that has ended keeps its state while others go on.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import ConicMultipliers, ConicSolver, WarmStart
from jaxscp.core import batching
from jaxscp.core.status import Status, StatusCode, usable
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.nlp.sensitivity import without_derivative
from jaxscp.problem.problem import OptimalControlProblem, node_times
from jaxscp.scp.history import History
from jaxscp.scp.method import End, MethodResult
from jaxscp.scp.nodal_subproblem import NormTrustRegion, TrustRegion, convexify
from jaxscp.transcription.discretise import Discretisation, discretise

KEPT = 0.99  # of virtual control, from a subproblem to the next, where it will not vanish
TIGHTER = 0.3  # times as accurate, from a subproblem to the next: errors that stay as large can keep steps so
SHARE = 7e-3  # of what is ahead, to which a subproblem is solved
ENDING = 5e-5  # accuracy of one that may be the last: of a coarser one small steps say nothing, a finer is of no use
# Lanes that a GPU steps at once: of fewer, the last of a kernel leave more of it idle. Of the few that need another
# subproblem or two, as many as it has room for.
TILES = 4096, 512


class PTRState(eqx.Module):
    """State of the loop."""

    z: Float[Array, "nodes variables"]
    """The reference: the last accepted iterate."""
    flow: Discretisation
    """The flow linearised about it."""
    cost: Scalar
    iterations: Count
    status: StatusCode
    done: Flag
    history: History
    prices: ConicMultipliers
    """Of the last subproblem."""


class PTR(eqx.Module):
    """Settings of the method; the paper's Table I and stopping rule by default.

    Args:
        trust_region: price of moving away from the reference.
        virtual_weight: price of virtual control, w_vc.
        tolerance_virtual: largest |nu_i| of a converged iterate.
        tolerance_step: largest |z_k - zref_k| of a converged iterate.
        max_iterations: subproblems allowed.
        substeps: RK4 steps an interval; never fewer than ten, since optimisers exploit the error of four.
        coarsest: relative accuracy of the first subproblem; the next are solved better and better. Zero solves all to
            the solver's tolerance, in far more Newton steps, for flights that cost much the same.
        conic: solver of the subproblems, which is told what accuracy is enough and where the solution may be near.
    """

    trust_region: TrustRegion = NormTrustRegion()
    virtual_weight: float = 1000.0
    tolerance_virtual: float = 1e-4
    tolerance_step: float = 1e-3
    max_iterations: int = eqx.field(default=50, static=True)
    substeps: int = eqx.field(default=10, static=True)
    coarsest: float = 1.0
    conic: ConicSolver = InteriorPoint(equilibration=1, refine_below=1e-5)

    @property
    def published(self) -> bool:
        """Whether the landing problem is stated as in the paper."""
        return True

    @property
    def holds_between_nodes(self) -> bool:
        """Whether a converged answer claims to keep its constraints between the nodes too."""
        return False

    def answer(self, problem: OptimalControlProblem, state: PTRState) -> MethodResult:
        """The end. It is no function of the problem: the iterations stop where moving no longer pays, which says more
        of the guess."""
        z, cost = without_derivative(state.z, problem), without_derivative(state.cost, problem)
        return MethodResult(z, cost, None, jnp.zeros((), bool), jnp.zeros((), int))

    def optimality(self, problem: OptimalControlProblem, end: End) -> None:
        """Nothing: where the trust region is priced by an unsquared norm, a stop says nothing of optimality."""

    def init(self, problem: OptimalControlProblem, z: Float[Array, "nodes variables"]) -> PTRState:
        """State before the first subproblem, from an initial guess."""
        zeros = jnp.zeros(self.max_iterations, z.dtype)
        counts = jnp.zeros(self.max_iterations, int)
        flow = discretise(problem, z, self.substeps)
        return PTRState(
            z=z,
            flow=flow,
            cost=jnp.zeros((), z.dtype),
            iterations=jnp.zeros((), int),
            status=Status.iteration_limit,
            done=jnp.zeros((), bool),
            history=History(zeros, zeros, zeros, zeros, zeros, zeros, counts),
            prices=ConicMultipliers.zeros(jax.eval_shape(lambda: self._program(problem, z, flow)[0])),
        )

    def step(self, problem: OptimalControlProblem, state: PTRState) -> PTRState:
        """Solve one subproblem and take its answer as the next reference."""
        program, cost = self._program(problem, state.z, state.flow)
        # a lane that has ended fills up a batch, and asks for nothing
        accuracy = jnp.where(self.terminate(state), jnp.inf, self.accuracy(state))
        solution = self.conic(program, accuracy, WarmStart(state.z, state.prices))
        good = usable(solution.status) & jnp.all(jnp.isfinite(solution.z))
        z = jnp.where(good, solution.z, state.z)
        flow = discretise(problem, z, self.substeps)
        virtual = jnp.max(jnp.linalg.norm(program.virtual_control(z), axis=1))
        moved = jnp.max(jnp.linalg.norm(z - state.z, axis=1))
        small_step = (moved < self.tolerance_step) & (accuracy <= ENDING)
        closed = virtual < self.tolerance_virtual
        row = History(
            cost=cost(z),
            objective=solution.objective,
            final_time=node_times(z[:, -1])[-1],
            virtual=virtual,
            step=moved,
            defect=largest_defect(problem, z, flow),
            conic_iterations=solution.iterations,
        )
        status = Status.where(closed, Status.iteration_limit, Status.dynamics_unmet)
        status = Status.where(closed & small_step, Status.converged, status)
        return PTRState(
            z=z,
            flow=flow,
            cost=cost(z),
            iterations=state.iterations + 1,
            status=Status.where(good, status, solution.status),
            done=~good | (small_step & (closed | _stays(virtual, state))),
            history=jax.tree.map(lambda h, v: h.at[state.iterations].set(v), state.history, row),
            prices=solution.multipliers,
        )

    def accuracy(self, state: PTRState) -> Scalar:
        """Relative accuracy that the next subproblem is worth: next to nothing is gained by more.

        A reference that moves far is soon another one; near the end, steps are about the square of the last one, until
        they are too small to matter.
        """
        last = state.history.step[state.iterations - 1]  # zero before the first, whose row is the last one's
        most = self.coarsest * TIGHTER ** state.iterations.astype(last.dtype)
        return jnp.where(state.iterations == 0, most, jnp.minimum(most, jnp.maximum(ENDING, SHARE * last**2)))

    def _program(
        self, problem: OptimalControlProblem, z: Float[Array, "nodes variables"], flow: Discretisation
    ):
        return convexify(problem, z, flow, self.trust_region, self.virtual_weight)

    def terminate(self, state: PTRState) -> Flag:
        """Whether the loop is over."""
        return state.done | (state.iterations >= self.max_iterations)

    def run(
        self, problem: OptimalControlProblem, z: Float[Array, "nodes variables"], wanted: Flag | bool = True
    ) -> PTRState:
        """Iterate from an initial guess to the end; not at all for a lane that is not wanted."""
        start = self.init(problem, z)
        start = eqx.tree_at(lambda s: s.done, start, ~jnp.asarray(wanted))
        return batching.while_loop(lambda state: ~self.terminate(state), self.step, problem, start, TILES)


def _stays(virtual: Scalar, state: PTRState) -> Flag:
    """Whether virtual control is what it was before the last subproblem: near a fixed point that does not change."""
    before = state.history.virtual[state.iterations - 1]
    return (state.iterations > 0) & (virtual > KEPT * before)


def largest_defect(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], flow: Discretisation
) -> Scalar:
    """Largest norm over the intervals of F(z_i) - x_{i+1}, physical states only."""
    n = problem.dynamics.state_size
    return jnp.max(jnp.linalg.norm(flow.state[:, :n] - z[1:, :n], axis=1))
