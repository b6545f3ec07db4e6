"""A planner: static choices; a call checks a scenario, states its problem, guesses, solves and certifies."""

import functools
import os
import pathlib
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from jaxscp.aot import aot, export, planner_cache
from jaxscp.backends.xla import jit_with_options
from jaxscp.core.status import Status
from jaxscp.core.types import Flag
from jaxscp.planner.scenario import Scenario
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.scp.method import Method, MethodResult, iterate
from jaxscp.scp.newton import NewtonSCP
from jaxscp.solver.load import load
from jaxscp.solver.solution import Solution
from jaxscp.solver.solve import conclude


class Planner(eqx.Module):
    """Plans a scenario: off the deck, through the corridor and back into the landing cone, say.

    All fields are static choices: a planner is hashable, and one shape of scenario compiles once for each planner.

    Args:
        nodes: N; the trajectory has N - 1 intervals.
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
    method: Method = NewtonSCP()
    samples: int = 200

    def __call__(self, scenario: Scenario) -> Solution:
        """Plan one scenario; use ``jax.vmap(planner)`` for a batch.

        Raises:
            InvalidScenario: if the scenario contradicts itself (outside ``jit`` and ``vmap`` only, before any
                compilation; inside them the status of that element is ``invalid_input``).
        """
        self._check(scenario)
        inputs = scenario.solver_inputs()
        if (compiled := planner_cache.cached(self._maker(), inputs)) is not None:
            return compiled.run(inputs)
        return _conclude(self, *_solve(self, *_setup(self, inputs)))

    def replan(self, solution: Solution, scenario: Scenario) -> Solution:
        """Plan a changed scenario, from the solution of a similar one."""
        self._check(scenario)
        inputs = scenario.solver_inputs()
        begun = (*_setup_again(self, inputs, solution.context), solution.z, solution.context)
        if (compiled := planner_cache.cached(self._maker(), inputs, begun)) is not None:
            return compiled.run_from(begun)
        return _conclude(self, *_solve(self, *begun))

    def compile(self, scenario: Scenario, batch_size: int | None = None) -> aot.CompiledPlanner:
        """Compile now for scenarios like this one; the compiled planner traces and compiles nothing more.

        Args:
            scenario: one scenario; only its parts, shapes and dtypes matter: ``jax.ShapeDtypeStruct`` will do.
            batch_size: scenarios a call, stacked along a leading axis; None for one without that axis.

        Raises:
            InvalidScenario: if shapes or dtypes contradict each other.

        Example:
            >>> import jaxscp
            >>> scenario = jaxscp.scenarios.ascent_to_platform()
            >>> planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1)).compile(scenario)
            >>> jaxscp.status_names(planner(scenario).status)
            'dynamics_unmet'
        """
        return aot.compiled(self.trace(scenario, batch_size))

    def export(self, file: str | os.PathLike, scenario: Scenario, batch_size: int | None = None) -> None:
        """Compile as ``compile`` does, and write the result to a file, for ``jaxscp.load``.

        The file holds the planner's programs twice: in portable form, for any machine of this platform, and compiled.

        Args:
            file: to write; ``planner.jaxscp``, say.
            scenario: as in ``compile``.
            batch_size: as in ``compile``.

        Raises:
            InvalidScenario: if shapes or dtypes contradict each other.
            NotImplementedError: if the method solves on the host (``conic.OSQP``), which no file can hold.
            OSError: if the file cannot be written.
        """
        traced = self.trace(scenario, batch_size)
        if not (folder := pathlib.Path(file).absolute().parent).is_dir():
            raise FileNotFoundError(f"{folder}: no such folder to write {os.fspath(file)} in")
        export.write(file, traced, export.programs_of(traced))

    def trace(self, scenario: Scenario, batch_size: int | None = None) -> aot.TracedPlanner:
        """The planner's programs for scenarios like this one, traced."""
        # Not as parts of another program: XLA then compiles them exactly as it does for a plain call.
        parts = [functools.partial(part.function, self) for part in (_setup, _solve, _conclude)]
        return aot.trace(parts, scenario, self.nodes, batch_size)

    def setup(self, scenario: Scenario):
        """Problem, first node variables and context of a scenario: the inputs of the iterations."""
        problem, context = scenario.problem(self.nodes, self.method.form)
        guess = scenario.guess(problem, context)
        return problem, problem.join(guess.state, guess.control, guess.dilation), context

    def _check(self, scenario: Scenario) -> None:
        if not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scenario)):
            scenario.check(self.nodes)

    def _maker(self) -> planner_cache.Maker:
        return planner_cache.Maker(self, self.trace, load)


# Three compiled parts. The first depends on the scenario's shape (polytopes, say), and is small. All scenarios with the
# same nodes and faces share the others, which are large: the solver and the verifier, compiled in parallel.
# The outputs of each part are the inputs of the next.


@functools.partial(jit_with_options, static_argnums=0)
def _setup(planner: Planner, scenario: Scenario):
    return _strongly_typed((scenario.valid(), *planner.setup(scenario)))


@functools.partial(jit_with_options, static_argnums=0)
def _setup_again(planner: Planner, scenario: Scenario, context: Any):
    problem, _ = scenario.problem(planner.nodes, planner.method.form, context)
    return _strongly_typed((scenario.valid(), problem))


@functools.partial(jit_with_options, static_argnums=0)
def _solve(planner: Planner, ok: Flag, problem: OptimalControlProblem, z, context: Any):
    return _strongly_typed((ok, problem, iterate(planner.method, problem, z, ok), context))


@functools.partial(jit_with_options, static_argnums=0)
def _conclude(
    planner: Planner, ok: Flag, problem: OptimalControlProblem, result: MethodResult, context: Any
) -> Solution:
    solution = conclude(planner.method, planner.samples, problem, result, context)
    return _blank_unless(ok, solution)


def _strongly_typed(values):
    """Without weak types: else 0.5 from Python and 0.5 from an array would each compile a solver of their own."""
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.result_type(v)), values)


def _blank_unless(ok, solution: Solution) -> Solution:
    """Zeros and ``invalid_input`` for an element whose scenario is not valid: nothing else passes on."""
    blank = jax.tree.map(lambda v: jnp.where(ok, v, jnp.zeros_like(v)), solution)
    return eqx.tree_at(lambda s: s.status, blank, Status.where(ok, solution.status, Status.invalid_input))
