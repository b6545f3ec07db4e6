"""``Solver`` and ``solve``: the front door for any optimal control problem."""

import os

import equinox as eqx

from jaxscp.problem.check import check_functions
from jaxscp.problem.parts import check_instance
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.method import Method
from jaxscp.scp.newton import NewtonSCP
from jaxscp.scp.ptr import PTR
from jaxscp.solver.compiled import CompiledSolver, signature
from jaxscp.solver.pipeline import Pipeline
from jaxscp.solver.request import Request, request
from jaxscp.solver.solution import Solution


class Solver(eqx.Module):
    """Solves optimal control problems; all fields are static choices.

    Args:
        method: ``NewtonSCP()`` (local optima, safe between the nodes), or ``PTR()`` (the paper's method).
        samples: points an interval at which the certificate checks the constraints.

    Example:
        >>> import jaxscp
        >>> problem = jaxscp.OptimalControlProblem(
        ...     dynamics=jaxscp.DoubleIntegrator(1),
        ...     cost=jaxscp.Cost(running=lambda x, u, t, p: u @ u),
        ...     boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([1.0, 0.0])),
        ...     time=jaxscp.Time(nodes=11, final=jaxscp.FixedTime(2.0)),
        ... )
        >>> solution = jaxscp.Solver()(problem, jaxscp.straight_line(problem))
        >>> jaxscp.status_names(solution.status), round(float(solution.cost), 5)  # exact: 12 / 2^3
        ('converged', 1.5)
    """

    method: Method = NewtonSCP()
    samples: int = 200

    def __call__(
        self, problem: OptimalControlProblem, guess: Trajectory | Solution, check: bool = False
    ) -> Solution:
        """Solve a problem from a guess.

        Args:
            problem: to solve; its numbers may be traced, by ``vmap`` and ``grad``, say.
            guess: a trajectory, or the solution of a similar problem; of any number of nodes.
            check: whether to compare the derivatives of the problem's functions with differences first, at the guess.

        Raises:
            InvalidProblem: if the request contradicts itself; the message names the field. Inside ``jit`` and ``vmap``
                the status of that element is ``invalid_input``, and its numbers are NaN.
        """
        asked = request(problem, guess)
        if check:
            check_functions(asked.asked, asked.start)
        return self._pipeline(asked)(asked)

    def compile(
        self, problem: OptimalControlProblem, guess: Trajectory | Solution, batch_size: int | None = None
    ) -> CompiledSolver:
        """Compile now, for problems with the same functions and shapes; calls then trace and compile nothing.

        Args:
            problem: one problem.
            guess: one guess.
            batch_size: problems a call, stacked along a leading axis; None for one without that axis.

        Raises:
            InvalidProblem: as in a call.
        """
        asked = request(problem, guess)
        compiled = self._pipeline(asked).compile(asked, batch_size)
        return CompiledSolver(compiled, signature(problem, asked))

    def export(
        self,
        file: str | os.PathLike,
        problem: OptimalControlProblem,
        guess: Trajectory | Solution,
        batch_size: int | None = None,
    ) -> None:
        """Compile as ``compile`` does, and write the result to a file, for ``jaxscp.load``.

        The file needs none of the code of the problem's functions.

        Raises:
            InvalidProblem: as in a call.
            NotImplementedError: if the method solves on the host (``conic.OSQP``), which no file can hold.
            OSError: if the file cannot be written.
        """
        asked = request(problem, guess)
        pipeline = self._pipeline(asked)
        traced = pipeline.trace(asked, batch_size)._replace(scenario=signature(problem, asked))
        pipeline.export(file, traced)

    def _pipeline(self, asked: Request) -> Pipeline:
        # to ask for the interface evaluates its properties: 0.7 ms
        if not isinstance(self.method, NewtonSCP | PTR):
            check_instance("method", self.method, Method)
        return Pipeline(asked.asked.time.nodes, self.method, self.samples)


def solve(
    problem: OptimalControlProblem,
    guess: Trajectory | Solution,
    method: Method = NewtonSCP(),  # noqa: B008
    check: bool = False,
) -> Solution:
    """Solve a problem from a guess: ``Solver(method)(problem, guess, check)``.

    Args:
        problem: to solve.
        guess: a trajectory, or the solution of a similar problem.
        method: that solves.
        check: whether to check the problem's functions first, at the guess.

    Raises:
        InvalidProblem: if the request contradicts itself.

    Example:
        >>> import jax.numpy as jnp, jaxscp as js
        >>> def car(x, u, t, p):  # x = (px, py, heading), u = (turn rate,)
        ...     return jnp.array([jnp.cos(x[2]), jnp.sin(x[2]), u[0]])
        >>> def outside(x, u, t, disc):
        ...     return jnp.linalg.norm(x[:2] - disc[:2])[None] - disc[2]
        >>> dubins = js.OptimalControlProblem(
        ...     dynamics=js.Dynamics.of(car, states=3, controls=1),
        ...     cost=js.Cost(running=lambda x, u, t, p: 1.0 + 0.01 * u @ u),
        ...     constraints=(
        ...         js.bounds(control=(-1.0, 1.0)),
        ...         js.Constraint(outside, js.NonNegative(), jnp.array([3.0, 0.2, 1.0])),
        ...     ),
        ...     boundary=js.Boundary(js.fixed_state([0.0, 0.0, 0.0]), js.fixed_state([6.0, 0.0, None])),
        ...     time=js.Time(nodes=30, final=js.FreeTime(1.0, 20.0)),
        ... )
        >>> solution = js.solve(dubins, js.straight_line(dubins, final_time=6.0))
        >>> js.status_names(solution.status)
        'converged'
    """
    return Solver(method)(problem, guess, check)
