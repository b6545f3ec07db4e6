"""A planner: a solver for scenarios, which state their problem and guess its solution."""

import os

import equinox as eqx
import numpy as np

from jaxscp.aot import aot
from jaxscp.problem.errors import InvalidScenario
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.method import Method
from jaxscp.scp.newton import NewtonSCP
from jaxscp.scp.nodal_subproblem import NormTrustRegion
from jaxscp.scp.ptr import PTR
from jaxscp.solver.pipeline import Pipeline
from jaxscp.solver.scenario import Scenario
from jaxscp.solver.solution import Solution


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

    @staticmethod
    def paper(nodes: int = 30) -> "Planner":
        """The paper's method with the weights of its Table I: the first feasible plan, in milliseconds.

        Constraints hold at the nodes alone, and the plan is no optimum.

        Example:
            >>> import jaxscp
            >>> jaxscp.Planner.paper(nodes=20).method.virtual_weight
            1000.0
        """
        return Planner(nodes, PTR(NormTrustRegion(10.0), virtual_weight=1000.0))

    def __call__(self, scenario: Scenario) -> Solution:
        """Plan one scenario; use ``jax.vmap(planner)`` for a batch.

        Raises:
            InvalidScenario: if the scenario contradicts itself (outside ``jit`` and ``vmap`` only, before any
                compilation; inside them the status of that element is ``invalid_input``).
        """
        return self.pipeline(scenario)

    def replan(self, solution: Solution | Trajectory, scenario: Scenario) -> Solution:
        """Plan a changed scenario, from the solution of a similar one.

        Args:
            solution: of this planner, or its trajectory: (nodes, states) and (nodes, controls). Each interval of a
                solution keeps its polytope, if the new corridor has as many; else polytopes are chosen anew.
            scenario: the changed one.

        Raises:
            InvalidScenario: as in a call; or if the trajectory has another number of nodes, states or controls.
        """
        return self.pipeline.again(solution, scenario)

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
        return self.pipeline.compile(scenario, batch_size)

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
        self.pipeline.export(file, self.pipeline.trace(scenario, batch_size))

    @property
    def pipeline(self) -> Pipeline:
        """Its programs.

        Raises:
            InvalidScenario: if a field of the planner is of another class.
        """
        for field, least in (("nodes", 2), ("samples", 2)):
            if not isinstance(value := getattr(self, field), int | np.integer) or value < least:
                raise InvalidScenario(f"{field}: expected a whole number, {least} or more, got {value!r}.")
        if isinstance(self.method, type) or not isinstance(self.method, Method):
            raise InvalidScenario(f"method: expected NewtonSCP() or PTR(), say, got {self.method!r}.")
        return Pipeline(self.nodes, self.method, self.samples)
