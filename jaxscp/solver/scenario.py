"""The interface that a pipeline needs of a scenario."""

from typing import Any, Protocol, runtime_checkable

from jaxscp.core.types import Flag
from jaxscp.problem.form import Form
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory


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

    def problem(self, nodes: int, form: Form, context: Any = None) -> tuple[OptimalControlProblem, Any]:
        """The problem on N nodes in a method's form, and its context: data that a re-plan uses again."""
        ...

    def guess(self, problem: OptimalControlProblem, context: Any) -> Trajectory:
        """A trajectory to start from."""
        ...

    def warm_guess(self, plan: Trajectory) -> Trajectory:
        """A trajectory to start a re-plan from, by the plan of a similar scenario."""
        ...
