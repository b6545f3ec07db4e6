"""A planner: a solver for scenarios, which state their problem and guess its solution."""

import os
from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxscp.aot import aot
from jaxscp.core.errors import InvalidScenario
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.method import Method
from jaxscp.scp.newton import NewtonSCP
from jaxscp.scp.nodal_subproblem import NormTrustRegion, ProximalTrustRegion
from jaxscp.scp.ptr import PTR
from jaxscp.solver.many import Many, solve_many
from jaxscp.solver.pipeline import Pipeline
from jaxscp.solver.scenario import Scenario
from jaxscp.solver.solution import Solution


class Planner(eqx.Module):
    """Plans a scenario: off the deck, through the corridor and back into the landing cone, say.

    All fields are static choices: a planner is hashable, and one shape of scenario compiles once for each planner.

    Args:
        nodes: N; the trajectory has N - 1 intervals. By default as many as the scenario's shape needs: 30 for up to 5
            legs of the route (polytopes and gates), 45 for up to 8, then 60, 90 or 5 intervals a leg.
        method: ``NewtonSCP()`` (local optima, safe between the nodes), or ``PTR()`` (the paper's method).
        samples: points an interval at which the certificate checks the constraints.

    Example:
        >>> import jaxscp
        >>> planner = jaxscp.Planner(nodes=20)
        >>> solution = planner(jaxscp.scenarios.ascent_to_platform())
        >>> jaxscp.status_names(solution.status)
        'converged'
    """

    nodes: int | None = None
    method: Method = NewtonSCP()
    samples: int = 200

    @staticmethod
    def paper(nodes: int | None = None) -> "Planner":
        """The paper's method with the weights of its Table I: the first feasible plan, in milliseconds.

        Constraints hold at the nodes alone, and the plan is no optimum.

        Example:
            >>> import jaxscp
            >>> jaxscp.Planner.paper(nodes=20).method.virtual_weight
            1000.0
        """
        return Planner(nodes, PTR(NormTrustRegion(10.0), virtual_weight=1000.0))

    @staticmethod
    def proximal(nodes: int | None = None) -> "Planner":
        """``PTR`` with a light proximal weight: it takes long steps, many of them.

        Example:
            >>> import jaxscp
            >>> jaxscp.Planner.proximal(nodes=20).method.max_iterations
            200
        """
        return Planner(nodes, PTR(ProximalTrustRegion(0.02), max_iterations=200))

    def __call__(self, scenario: Scenario) -> Solution:
        """Plan one scenario; use ``jax.vmap(planner)`` for a batch.

        Raises:
            InvalidScenario: if the scenario contradicts itself (outside ``jit`` and ``vmap`` only, before any
                compilation; inside them the status of that element is ``invalid_input``).
        """
        return self.pipeline(scenario)

    def replan(
        self, solution: Solution | Trajectory, scenario: Scenario, elapsed: Float[Array, ""] | float = 0.0
    ) -> Solution:
        """Plan a changed scenario, from the solution of a similar one.

        Where that does not converge, the scenario is planned anew, as by a call; ``fell_back`` says so.

        Args:
            solution: of this planner, or its trajectory: (nodes, states) and (nodes, controls). Each interval of a
                solution keeps its polytope, if the new corridor has as many; else polytopes are chosen anew.
            scenario: the changed one. Its start is the present state. It may lie 0.1 m outside of a wall or a zone, and
                a tenth beyond a limit; ``recovers`` of the solution then says so. Its time zero is now: the goal of a
                moving deck is the deck's present place, as of ``scenario.after(elapsed)`` or measured.
            elapsed: s since the start of the solution, which only its rest serves. Of a solution, polytopes and gates
                before that lie behind: they ask for nothing any more.

        Raises:
            InvalidScenario: as in a call; or if the trajectory has another number of nodes, states or controls, or
                ``elapsed`` lies outside of its time.
        """
        return self.pipeline.again(solution, scenario, elapsed)

    def map(
        self,
        scenarios: Scenario | Iterable[Scenario],
        batch_size: int | None = None,
        *,
        workers: int | None = None,
        devices: tuple[Any, ...] = (),
        keep: Callable[[Any], Any] | None = None,
        progress: Callable[[int, int | None], Any] | None = None,
    ) -> Any:
        """Plan any number of scenarios by one compiled program.

        On a CPU, threads plan scenarios one by one, on all usable cores, by the program that a call uses. On other
        devices, batches of one size are planned; the last one is padded. Memory does not grow with the number of
        scenarios, but for what ``keep`` returns. Ctrl-C ends the call at once.

        Args:
            scenarios: one pytree with a leading axis on every array, or an iterable of scenarios of one shape, drawn
                as they are needed.
            batch_size: scenarios of the program; by default 1 on a CPU and 1024 elsewhere.
            workers: threads; by default the number of usable cores, and 2 for batches. Results do not depend on it.
            devices: that share each batch, by ``jax.shard_map``; by default JAX's default device alone.
            keep: from solutions with a leading axis, as NumPy arrays, to a pytree of arrays with that axis: to hold
                less in memory.
            progress: called with the number of scenarios planned and the number of all, None if unknown.

        Returns:
            Solutions with a leading axis, as NumPy arrays; with ``keep``, its results. An invalid scenario has the
            status ``invalid_input``, and NaN in every float.

        Raises:
            InvalidScenario: if shapes contradict each other; the message names the field.
            ValueError: if a number is wrong.

        Example:
            >>> import jaxscp
            >>> scenario = jaxscp.scenarios.ascent_to_platform()
            >>> planner = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))
            >>> planner.map([scenario, scenario], keep=lambda solutions: solutions.cost).shape
            (2,)
        """
        return solve_many(self.pipeline, scenarios, Many(batch_size, workers, devices), keep, progress)

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

    def nodes_for(self, scenario: Scenario) -> int:
        """Nodes of a scenario's plan.

        Example:
            >>> import jaxscp
            >>> jaxscp.Planner().nodes_for(jaxscp.scenarios.platform_to_platform())
            30
        """
        return self.pipeline.nodes_for(scenario)

    def __check_init__(self):
        """See Equinox; called after construction.

        Raises:
            InvalidScenario: if a field is of another class.
        """
        for field, least in (("nodes", 2), ("samples", 2)):
            if field == "nodes" and self.nodes is None:
                continue
            if not isinstance(value := getattr(self, field), int | np.integer) or value < least:
                raise InvalidScenario(f"{field}: expected a whole number, {least} or more, got {value!r}.")
        # To ask for the interface evaluates its properties, which takes longer than all else here.
        ours = isinstance(self.method, NewtonSCP | PTR)
        if not ours and (isinstance(self.method, type) or not isinstance(self.method, Method)):
            hint = " Planner.paper() is the paper's." if self.method == "paper" else ""
            raise InvalidScenario(f"method: expected NewtonSCP() or PTR(), say, got {self.method!r}.{hint}")

    @property
    def pipeline(self) -> Pipeline:
        """Its programs."""
        self.__check_init__()  # a transformation may have changed a field
        return Pipeline(self.nodes, self.method, self.samples)
