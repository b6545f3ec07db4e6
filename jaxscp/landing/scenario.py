"""A landing scenario: a mission with the interface that a planner needs."""

import equinox as eqx
import jax
from jaxtyping import Array, Int

from jaxscp.core.types import Flag
from jaxscp.landing.allocation import allocate
from jaxscp.landing.guess import initial_guess
from jaxscp.landing.mission import Mission
from jaxscp.landing.problem import landing_problem
from jaxscp.landing.units import Units, in_units, units_of
from jaxscp.landing.validation import check_types, valid, validate
from jaxscp.landing.warm_guess import warm_guess
from jaxscp.problem.form import Form
from jaxscp.problem.node_values import node_times
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory

Allocation = Int[Array, "intervals"]
"""Polytope of every interval."""


class LandingScenario(Mission):
    """All data of a landing as one pytree; every float is a leaf that a study may vary.

    Example:
        >>> import dataclasses, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> scenario.corridor.count
        5
        >>> slow = dataclasses.replace(scenario, limits=jaxscp.flight_limits(speed=3.0))
    """

    def check(self, nodes: int) -> None:
        """Raise ``InvalidScenario`` if the scenario contradicts itself.

        Leaves may be ``jax.ShapeDtypeStruct``: then shapes and dtypes are checked, and no values.
        """
        if any(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(self)):
            check_types(self, nodes)
        else:
            validate(self, nodes)

    def valid(self) -> Flag:
        """Whether the scenario is valid, as an array: for elements of a batch."""
        return valid(self)

    def solver_inputs(self) -> "LandingScenario":
        """The scenario without its obstacles, which no solver reads: any number of them shares one program."""
        if self.obstacles is None:
            return self
        return eqx.tree_at(lambda s: s.obstacles, self, None)

    def in_solver_units(self, form: Form) -> tuple["LandingScenario", Units | None]:
        """The scenario in units taken from it, and the units.

        Args:
            form: statement that the method solves; the paper's weights are for the user's own units.
        """
        if form.carries_cost:
            return self, None
        units = units_of(self)
        return in_units(self, units), units

    def problem(
        self, nodes: int, form: Form, context: Allocation | None = None
    ) -> tuple[OptimalControlProblem, Allocation]:
        """The optimal control problem, and the polytope of every interval.

        Args:
            nodes: N.
            form: statement that the method solves.
            context: allocation to use again, in a re-plan.
        """
        if context is None:
            frozen = jax.lax.stop_gradient(self)  # the allocation is no differentiable function
            context = allocate(frozen.corridor, frozen.start.position, frozen.goal.position, nodes)
        return landing_problem(self, context, form), context

    def guess(self, problem: OptimalControlProblem, context: Allocation) -> Trajectory:
        """A smooth trajectory through the corridor, without derivatives."""
        guess = initial_guess(jax.lax.stop_gradient(self), context)
        return Trajectory(node_times(guess.dilation), guess.states, guess.controls, guess.dilation)

    def warm_guess(self, plan: Trajectory) -> Trajectory:
        """A plan of a similar scenario, moved to this one's start and goal."""
        return warm_guess(jax.lax.stop_gradient(self), plan)
