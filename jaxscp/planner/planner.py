"""The front door: a planner is a set of static choices; calling it plans one scenario."""

import functools
import os
import pathlib

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Int

from jaxscp.aot import aot, export
from jaxscp.aot.planner_cache import kept
from jaxscp.backends.xla import jit_with_options
from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.core.types import Flag
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import initial_guess
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.scenario import LandingScenario
from jaxscp.landing.validation import valid, validate
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.method import End, MethodResult, solve
from jaxscp.scp.newton import NewtonSCP
from jaxscp.scp.ptr import PTR
from jaxscp.solver.solution import Solution
from jaxscp.transcription.layout import trajectory_of
from jaxscp.verification.certificate import Certificate, acceptable, certify

CERTIFIED_AT_ONCE = (4096,)  # on a GPU, which is as long over fewer


class Planner(eqx.Module):
    """Plans a flight off the deck, through the corridor and back into the landing cone.

    All fields are static choices: a planner is hashable, and one scenario shape compiles once for each planner.

    Args:
        nodes: N; the flight has N - 1 intervals.
        method: ``NewtonSCP()`` (local optima, safe between the nodes), or ``PTR()`` (the paper's method).
        samples: points an interval at which the certificate checks the constraints.

    Example:
        >>> import jaxscp
        >>> planner = jaxscp.Planner(nodes=20)
        >>> solution = planner(jaxscp.scenarios.ascent_to_platform())
        >>> jaxscp.status_names(solution.status)
        'converged'
    """

    nodes: int = 30
    method: NewtonSCP | PTR = NewtonSCP()
    samples: int = 200

    def __call__(self, scenario: LandingScenario) -> Solution:
        """Plan one scenario; use ``jax.vmap(planner)`` for a batch.

        Raises:
            InvalidScenario: if the scenario contradicts itself (outside ``jit`` and ``vmap`` only, before any
                compilation; inside them the lane's status is ``invalid_input``).
        """
        self._check(scenario)
        bare = aot.without_obstacles(scenario)
        if (compiled := kept(self, bare)) is not None:
            return compiled.run(bare)
        return _conclude(self, *_solve(self, *_setup(self, bare)))

    def replan(self, solution: Solution, scenario: LandingScenario) -> Solution:
        """Plan a changed scenario, starting from the solution of a like one."""
        self._check(scenario)
        bare = aot.without_obstacles(scenario)
        begun = (*_setup_again(self, bare, solution.allocation), solution.z, solution.allocation)
        if (compiled := kept(self, bare, begun)) is not None:
            return compiled.go_on(begun)
        return _conclude(self, *_solve(self, *begun))

    def compile(self, scenario: LandingScenario, lanes: int | None = None) -> aot.CompiledPlanner:
        """Compile now for scenarios like this one; what is returned traces and compiles nothing more.

        Args:
            scenario: one scenario; only its parts, shapes and dtypes matter, so that ``jax.ShapeDtypeStruct`` will do.
            lanes: how many scenarios a call takes, stacked along a leading axis; None for one without that axis.

        Raises:
            InvalidScenario: if shapes or dtypes contradict each other.

        Example:
            >>> import jaxscp
            >>> scenario = jaxscp.scenarios.ascent_to_platform()
            >>> planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1)).compile(scenario)
            >>> jaxscp.status_names(planner(scenario).status)
            'dynamics_unmet'
        """
        return aot.compiled(self.plan_ahead(scenario, lanes))

    def export(self, file: str | os.PathLike, scenario: LandingScenario, lanes: int | None = None) -> None:
        """Compile as ``compile`` does, and write what comes of it to a file, for ``jaxscp.load``.

        The file holds the planner's programs twice: in portable form, for any machine of this platform, and compiled.

        Args:
            file: to write; ``planner.jaxscp``, say.
            scenario: as in ``compile``.
            lanes: as in ``compile``.

        Raises:
            InvalidScenario: if shapes or dtypes contradict each other.
            NotImplementedError: if the method solves on the host (``conic.OSQP``), which no file can hold.
            OSError: if the file cannot be written.
        """
        plan = self.plan_ahead(scenario, lanes)
        if not (folder := pathlib.Path(file).absolute().parent).is_dir():
            raise FileNotFoundError(f"{folder}: no such folder to write {os.fspath(file)} in")
        export.write(file, plan, export.programs_of(plan))

    def plan_ahead(self, scenario: LandingScenario, lanes: int | None = None) -> aot.Plan:
        """What is to be compiled for scenarios like this one."""
        # Not as parts of another program, so that XLA makes the same of them as where they are called.
        parts = [functools.partial(part.function, self) for part in (_setup, _solve, _conclude)]
        return aot.plan_ahead(parts, scenario, self.nodes, lanes)

    def _check(self, scenario: LandingScenario) -> None:
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scenario)):
            return
        validate(scenario, self.nodes)

    def setup(self, scenario: LandingScenario):
        """Problem, first node variables and allocation of a scenario: what the iterations start from."""
        frozen = jax.lax.stop_gradient(scenario)  # where the iterations start is no function of the scenario
        allocation = allocate(frozen.corridor, frozen.start.position, frozen.goal.position, self.nodes)
        problem = landing_problem(scenario, allocation, self.method.published)
        guess = initial_guess(frozen, allocation)
        return problem, problem.join(guess.states, guess.controls, guess.dilation), allocation

    def conclude(
        self,
        problem: OptimalControlProblem,
        end: End,
        answer: MethodResult,
        allocation: Int[Array, "intervals"],
    ) -> Solution:
        """Certify what the iterations ended with."""
        trajectory = trajectory_of(problem, answer.z)
        frozen, flown = jax.lax.stop_gradient((problem, trajectory))
        certificate = batching.in_tiles(
            lambda fixed: self._certify(*fixed), (frozen, end, flown), CERTIFIED_AT_ONCE
        )
        refuted = (end.status == Status.converged) & ~acceptable(certificate, self.method.holds_between_nodes)
        return Solution(
            status=Status.where(refuted, Status.refuted, end.status),
            trajectory=trajectory,
            cost=answer.cost,
            final_time=trajectory.time[-1],
            iterations=end.iterations,
            newton_steps=answer.newton_steps,
            differentiable=answer.reached,
            multipliers=answer.multipliers,
            certificate=certificate,
            history=end.history,
            z=answer.z,
            allocation=allocation,
        )

    def _certify(self, problem: OptimalControlProblem, end: End, flown: Trajectory) -> Certificate:
        return certify(problem, flown, self.samples, self.method.optimality(problem, end))


# Three compiled parts. What depends on the scenario's own shape (polytopes, say) is small, and all flights of as many
# nodes and faces share the others, which are large: what solves, and what judges, which can be compiled side by side.
# Each returns what the next one takes.


@functools.partial(jit_with_options, static_argnums=0)
def _setup(planner: Planner, scenario: LandingScenario):
    return _strongly_typed((valid(scenario), *planner.setup(scenario)))


@functools.partial(jit_with_options, static_argnums=0)
def _setup_again(planner: Planner, scenario: LandingScenario, allocation):
    return _strongly_typed((valid(scenario), landing_problem(scenario, allocation, planner.method.published)))


@functools.partial(jit_with_options, static_argnums=0)
def _solve(planner: Planner, ok: Flag, problem: OptimalControlProblem, z, allocation):
    return _strongly_typed((ok, problem, *solve(planner.method, problem, z, ok), allocation))


@functools.partial(jit_with_options, static_argnums=0)
def _conclude(
    planner: Planner, ok: Flag, problem: OptimalControlProblem, end: End, answer: MethodResult, allocation
) -> Solution:
    return _blank_unless(ok, planner.conclude(problem, end, answer, allocation))


def _strongly_typed(values):
    """Without weak types: else 0.5 from Python and 0.5 from an array would each compile a solver of their own."""
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.result_type(v)), values)


def _blank_unless(ok, solution: Solution) -> Solution:
    """Zeros and ``invalid_input`` for a lane whose scenario is not valid, so that nothing else passes on."""
    blank = jax.tree.map(lambda v: jnp.where(ok, v, jnp.zeros_like(v)), solution)
    return eqx.tree_at(lambda s: s.status, blank, Status.where(ok, solution.status, Status.invalid_input))
