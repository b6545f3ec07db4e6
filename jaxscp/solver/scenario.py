"""The interface that a pipeline needs of a scenario."""

from typing import Any, Protocol, runtime_checkable

from jaxtyping import Array, Int

from jaxscp.core.obstacles import Hull
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.form import Form
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.sized import Sized


@runtime_checkable
class Units(Protocol):
    """Units that a scenario is solved in."""

    @property
    def time(self) -> Scalar:
        """Size of the unit of time, in the user's."""
        ...

    @property
    def cost(self) -> Scalar:
        """Size of the unit of cost, in the user's."""
        ...

    def trajectory(self, own: Trajectory) -> Trajectory:
        """A trajectory in the user's units, from one in these."""
        ...

    def own_trajectory(self, plan: Trajectory) -> Trajectory:
        """A trajectory in these units, from one in the user's."""
        ...

    def multipliers(self, problem: ScaledTimeProblem, own: Multipliers) -> Multipliers:
        """Multipliers in the user's units, from the multipliers of the problem in these units."""
        ...


@runtime_checkable
class Scenario(Protocol):
    """A pytree that states an optimal control problem and guesses its solution. ``LandingScenario`` is one."""

    def check(self, nodes: int) -> None:
        """Raise an error that names the field, if the scenario contradicts itself; called before compilation.

        Leaves may be ``jax.ShapeDtypeStruct``: then shapes and dtypes are checked, and no values.
        """
        ...

    def valid(self) -> Flag:
        """Whether the scenario is valid, as an array: for elements of a batch."""
        ...

    def solver_inputs(self) -> Any:
        """The scenario without the parts that no solver reads."""
        ...

    def usual_nodes(self) -> int:
        """Nodes of a planner that states none, by shapes alone."""
        ...

    def measured(self) -> Any:
        """The scenario, for a start that is measured: it may lie a little outside of what the scenario allows."""
        ...

    def starts_outside(self) -> Flag:
        """Whether it does."""
        ...

    def without_passed(self, context: Any, interval: Int[Array, ""], time: Scalar) -> tuple[Any, Any]:
        """The rest of the scenario from an interval of a plan on, ``time`` s long, and the plan's context for it."""
        ...

    def in_solver_units(self, form: Form) -> tuple["Scenario", Units | None]:
        """The scenario in the units that a method works in, and these units; None for the user's own."""
        ...

    def problem(self, nodes: int, form: Form, context: Any = None) -> tuple[OptimalControlProblem, Any]:
        """The problem on N nodes in a method's form, and its context: data that a re-plan uses again."""
        ...

    def guess(self, problem: OptimalControlProblem, context: Any) -> Trajectory:
        """A trajectory to start from."""
        ...

    def sized(self, stated: OptimalControlProblem, guess: Trajectory, form: Form) -> Sized | None:
        """The problem in sizes that are measured at a guess, and again at its solution; None if its units are good."""
        ...

    def hull(self, context: Any) -> Hull | None:
        """The vehicle among known obstacles, which the certificate alone judges; None if there are none."""
        ...

    def warm_guess(self, plan: Trajectory) -> Trajectory:
        """A trajectory to start a re-plan from, by the plan of a similar scenario."""
        ...


@runtime_checkable
class Advisor(Protocol):
    """A scenario that says more of its plans than the certificate does; no scenario needs to."""

    def hindrance(self, plan: Trajectory) -> str:
        """What hinders a plan that did not converge; empty if nothing is known."""
        ...

    def replan_doubt(self, plan: Trajectory, elapsed: float) -> str:
        """Doubt about this scenario as the present one, ``elapsed`` s after the start of a plan; empty if none."""
        ...
