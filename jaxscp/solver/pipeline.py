"""From a scenario to a certified solution, in three compiled programs: set up, solve, conclude.

The first depends on the scenario's shape (polytopes, say), and is small. All scenarios with the same nodes and rows
share the others, which are large: the solver and the verifier, compiled in parallel. The outputs of each part are the
inputs of the next.
"""

import dataclasses
import functools
import os
import pathlib
import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxscp.aot import aot, export, planner_cache
from jaxscp.backends.xla import any_rank, is_traced, jit_with_options
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.canonical import canonical
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.method import Method, MethodResult, iterate
from jaxscp.solver.conclude import Measures, Reported, conclude, solution_if_valid
from jaxscp.solver.fallback import better
from jaxscp.solver.load import load_planner
from jaxscp.solver.rest import checked_seconds, replan_doubt, rest_of
from jaxscp.solver.scenario import Scenario
from jaxscp.solver.sized import Sized, iterate_sized
from jaxscp.solver.solution import Solution


class Pipeline(eqx.Module):
    """Static choices; one shape of scenario compiles once for each.

    Args:
        nodes: N; the trajectory has N - 1 intervals. None takes the scenario's usual number.
        method: that solves.
        samples: points an interval at which the certificate checks the constraints.
    """

    nodes: int | None
    method: Method
    samples: int

    @any_rank
    def __call__(self, scenario: Scenario) -> Solution:
        """The solution of a scenario."""
        _check_class(scenario)
        scenario = aot.with_arrays(scenario)
        inputs = scenario.solver_inputs()
        if (compiled := planner_cache.known(self._maker(), inputs)) is not None:
            solution = compiled.run(inputs)  # in the background: the check costs no time
            self.check(scenario)
            return solution
        self.check(scenario)
        return self.program(inputs)(inputs)

    def again(
        self, solution: Solution | Trajectory, scenario: Scenario, elapsed: Scalar | float = 0.0
    ) -> Solution:
        """The solution of a changed scenario, from the solution of a similar one, or from its trajectory.

        Where that does not converge, the scenario is planned anew.

        Args:
            solution: of the similar one.
            scenario: the changed one.
            elapsed: s since the solution's start.
        """
        known = solution if isinstance(solution, Solution) else None
        plan: Any = solution if known is None else known.trajectory
        self._check_plan(plan)
        _check_class(scenario)
        fixed = dataclasses.replace(self, nodes=plan.nodes)
        context = None if known is None else known.context
        scenario = aot.with_arrays(scenario).measured()
        traced = is_traced(elapsed)
        seconds = elapsed if traced else checked_seconds(plan, elapsed)
        # Bounds of a kept mesh move with the scenario, which derivatives do not see: where those may be asked for, the
        # mesh is free.
        keep_mesh = not is_traced((plan, scenario, elapsed)) and seconds > 0.0
        if traced or seconds > 0.0:
            fixed.check_shapes(scenario)
            if (doubt := replan_doubt(plan, scenario, seconds)) is not None:
                warnings.warn(doubt, stacklevel=3)
            plan, scenario, context = rest_of(plan, context, scenario, seconds)
        found = fixed._from_plan(plan.with_dynamics(None), context, scenario, jnp.asarray(keep_mesh))
        return better(found, functools.partial(fixed._from_guess, scenario))

    @any_rank
    def _from_guess(self, scenario: Scenario, needed: Flag) -> Solution:
        """The solution of a scenario that was checked; where it is not needed, no step is taken."""
        inputs = aot.with_arrays(scenario).solver_inputs()
        ok, *rest = _setup(self, inputs)
        return self._finish(inputs, (ok & needed, *rest))

    @any_rank
    def _from_plan(self, plan: Trajectory, context: Any, scenario: Scenario, keep_mesh: Flag) -> Solution:
        """The solution from a plan; one with dynamics would compile another program."""
        scenario = aot.with_arrays(scenario)
        self.check(scenario)
        inputs = scenario.solver_inputs()
        return self._finish(inputs, _setup_again(self, inputs, context, plan, keep_mesh))

    @any_rank
    def compile(self, scenario: Scenario, batch_size: int | None = None) -> aot.CompiledPlanner:
        """The programs, compiled for scenarios like this one."""
        return aot.compiled(self.trace(scenario, batch_size))

    @any_rank
    def export(self, file: str | os.PathLike, traced: aot.TracedPlanner) -> None:
        """Compile traced programs and write them to a file."""
        if not (folder := pathlib.Path(file).absolute().parent).is_dir():
            raise FileNotFoundError(f"{folder}: no such folder to write {os.fspath(file)} in")
        export.write(file, traced, export.programs_of(traced))

    @any_rank
    def trace(
        self, scenario: Scenario, batch_size: int | None = None, devices: tuple[Any, ...] = ()
    ) -> aot.TracedPlanner:
        """The programs for scenarios like this one, traced; each device takes its share of a batch."""
        _check_class(scenario)
        # Not as parts of another program: XLA then compiles them exactly as it does for a plain call.
        parts = [functools.partial(part.function, self) for part in (_setup, _solve, _conclude)]
        planner_cache.make_room()
        return aot.trace(parts, aot.with_arrays(scenario), self.nodes_for(scenario), batch_size, devices)

    def program(
        self, like: Any, batch_size: int | None = None, devices: tuple[Any, ...] = ()
    ) -> Callable[[Any], Solution]:
        """The function of inputs like these, compiled once for all calls of a thread.

        Args:
            like: inputs of one scenario.
            batch_size: of the inputs' leading axis; None for none.
            devices: that share a batch; the default one if empty.
        """
        if (compiled := planner_cache.cached(self._maker(batch_size, devices), like)) is not None:
            return compiled.run
        one = lambda inputs: _conclude(self, *_solve(self, *_setup(self, inputs)))  # noqa: E731
        return any_rank(one if batch_size is None else aot.batched(one, devices))

    def setup(self, scenario: Scenario) -> tuple[ScaledTimeProblem, Any, Any]:
        """Problem over scaled time, first node variables and context: the inputs of the iterations."""
        _, _, problem, z, _, (_, context, *_) = _inputs(self, scenario)
        return problem, z, context

    def nodes_for(self, scenario: Scenario) -> int:
        """Nodes of a scenario's plan."""
        return scenario.usual_nodes() if self.nodes is None else self.nodes

    def check(self, scenario: Scenario) -> None:
        """Check a scenario: its parts and shapes, and its values where all are known."""
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scenario)):
            self.check_shapes(scenario)
        else:
            _check_class(scenario)
            scenario.check(self.nodes_for(scenario))

    def check_shapes(self, scenario: Scenario) -> None:
        """Check a scenario's parts and shapes, not its values."""
        _check_class(scenario)
        shape_of = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype) if hasattr(v, "dtype") else v  # noqa: E731
        scenario = jax.tree.map(shape_of, scenario)
        scenario.check(self.nodes_for(scenario))

    def _check_plan(self, plan: Any) -> None:
        """Check the trajectory of a re-plan, before anything is compiled."""
        if not isinstance(plan, Trajectory):
            raise InvalidScenario(f"solution: expected a Solution or a Trajectory, got {_class_of(plan)}.")
        if (axes := plan.state.ndim) != 2:
            raise InvalidScenario(f"solution: expected one plan, got {axes - 2} leading axes; use jax.vmap.")
        if not is_traced(plan) and not np.all(np.isfinite(plan.state)):
            raise InvalidScenario("solution: its trajectory holds NaN, as after invalid_input; plan anew.")
        if self.nodes not in (None, plan.nodes):
            raise InvalidScenario(
                f"solution: its trajectory has {plan.state.shape[0]} nodes, but the planner has {self.nodes}. "
                f"Plan with Planner(nodes={self.nodes}), or take trajectory.resampled({self.nodes})."
            )

    def _finish(self, inputs: Any, begun: Any) -> Solution:
        """The solution from the inputs of the iterations."""
        if (compiled := planner_cache.cached(self._maker(), inputs, begun)) is not None:
            return compiled.run_from(begun)
        return _conclude(self, *_solve(self, *begun))

    def _maker(self, batch_size: int | None = None, devices: tuple[Any, ...] = ()) -> planner_cache.Maker:
        if batch_size is None:
            return planner_cache.Maker(self, self.trace, load_planner)
        trace = functools.partial(self.trace, batch_size=batch_size, devices=devices)
        return planner_cache.Maker((self, batch_size, devices), trace, load_planner)


def _inputs(
    pipeline: Pipeline,
    scenario: Scenario,
    context: Any = None,
    plan: Trajectory | None = None,
    keep_mesh: Flag | bool = False,
):
    """Inputs of the iterations, in the solver's units; and about the solution: problem asked, context and hull.

    Args:
        pipeline: nodes and method.
        scenario: in the user's units.
        context: of an earlier solution, or None.
        plan: to start from, in the user's units; None for the scenario's own guess.
        keep_mesh: whether the plan's mesh is a good one.
    """
    nodes, form = pipeline.nodes_for(scenario), pipeline.method.form
    own, units = scenario.in_solver_units(form)
    stated, context = own.problem(nodes, form, context)
    if plan is None:
        guess = own.guess(stated, context)
    else:
        guess = scenario.warm_guess(plan)
        guess = guess if units is None else units.own_trajectory(guess)
    stated, reported = canonical(stated), None
    sized = own.sized(stated, guess, form)
    problem = over_scaled_time(stated, form, guess) if sized is None else sized.problem()
    if units is not None:
        asked, _ = scenario.problem(nodes, form, context)
        reported = Reported(over_scaled_time(canonical(asked), form), units)
    z = problem.join(guess.state, guess.control, guess.dilation)
    return (
        scenario.valid(),
        jnp.asarray(keep_mesh),
        problem,
        z,
        sized,
        (reported, context, scenario.hull(context), scenario.starts_outside()),
    )


def _check_class(scenario: Any) -> None:
    if isinstance(scenario, type) or not isinstance(scenario, Scenario):
        raise InvalidScenario(
            f"scenario: expected one, got {_class_of(scenario)}. jaxscp.scenarios.through(corridor, start, goal) makes "
            "one."
        )


def _class_of(value: Any) -> str:
    return "None" if value is None else f"a value of class {type(value).__name__}"


@functools.partial(jit_with_options, static_argnums=0)
def _setup(pipeline: Pipeline, scenario: Scenario):
    return _strongly_typed(_inputs(pipeline, scenario))


@functools.partial(jit_with_options, static_argnums=0)
def _setup_again(pipeline: Pipeline, scenario: Scenario, context: Any, plan: Trajectory, keep_mesh: Flag):
    return _strongly_typed(_inputs(pipeline, scenario, context, plan, keep_mesh))


@functools.partial(jit_with_options, static_argnums=0)
def _solve(
    pipeline: Pipeline,
    ok: Flag,
    keep_mesh: Flag,
    problem: ScaledTimeProblem,
    z,
    sized: Sized | None,
    about: Any,
):
    if sized is None:
        result = iterate(pipeline.method, problem, z, ok, keep_mesh)
    else:
        result, problem, sized = iterate_sized(pipeline.method, sized, ok, keep_mesh)
    return _strongly_typed((ok, problem, result, sized, about))


@functools.partial(jit_with_options, static_argnums=0)
def _conclude(
    pipeline: Pipeline,
    ok: Flag,
    problem: ScaledTimeProblem,
    result: MethodResult,
    sized: Sized | None,
    about: Any,
) -> Solution:
    reported, context, hull, outside = about
    measures = Measures(sized, hull)
    solution = conclude(pipeline.method, pipeline.samples, problem, result, context, reported, measures)
    solution = eqx.tree_at(lambda s: s.recovers, solution, outside)
    return solution_if_valid(ok, solution)


def _strongly_typed(values):
    """Without weak types: else 0.5 from Python and 0.5 from an array would each compile a solver of their own."""
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.result_type(v)), values)
