"""Solving a problem of one's own, for the field ``run`` of a study."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.request import request
from jaxscp.solver.solution import Solution
from jaxscp.solver.solver import Solver


class Solves(eqx.Module):
    """The solution of every case, from one guess or from a guess for each.

    Args:
        guess: a trajectory, a solution of the problem's base, or a function from a case to one of them.
        solver: that solves.
    """

    guess: Trajectory | Solution | Callable[[Any], Any]
    solver: Solver = Solver()

    def __call__(self, problem: OptimalControlProblem) -> Solution:
        """The solution of one case."""
        return self.solver(problem, self._guess_for(problem))

    def check(self, problem: OptimalControlProblem) -> None:
        """Raise ``InvalidProblem`` if a case contradicts itself. Solves nothing."""
        asked = request(problem, self._guess_for(problem))
        asked.check(asked.usual_nodes())

    def _guess_for(self, problem: OptimalControlProblem) -> Any:
        guess: Any = self.guess
        return guess if isinstance(guess, Trajectory | Solution) else guess(problem)
