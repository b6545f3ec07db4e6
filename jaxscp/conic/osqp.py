"""OSQP on the quadratic form of a program, with the interior point's interface; runs on the host.

OSQP is an operator-splitting method: thousands of cheap iterations to moderate accuracy. Here it checks the interior
point independently, and solves wherever a plain quadratic program is preferred.

OSQP is fast with a quadratic cost and slow with a linear one, as in the paper's mode. It proves infeasibility best with
its own scaling, which slows everything else. So there are up to three attempts, cheapest first, until one decides. The
last attempt is the proximal-point method: each round adds curvature about the previous result, which is fast again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Int

from jaxscp.backends.serving import index_of
from jaxscp.conic.program import ConicMultipliers, ConicSolution, StagedProgram, WarmStart
from jaxscp.conic.quadratic import DEFAULT_FACETS, QuadraticProgram, quadratic_form
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.types import Scalar

# Status for each of OSQP's codes; any other code (a time limit, an interrupt) is insufficient progress.
_STATUS_OF_CODE = {
    "OSQP_SOLVED": Status.converged,
    "OSQP_SOLVED_INACCURATE": Status.almost_converged,
    "OSQP_PRIMAL_INFEASIBLE": Status.infeasible,
    "OSQP_PRIMAL_INFEASIBLE_INACCURATE": Status.infeasible,
    "OSQP_DUAL_INFEASIBLE": Status.unbounded,
    "OSQP_DUAL_INFEASIBLE_INACCURATE": Status.unbounded,
    "OSQP_MAX_ITER_REACHED": Status.iteration_limit,
    "OSQP_NON_CVX": Status.numerical_error,
    "OSQP_UNSOLVED": Status.numerical_error,
}
_DECISIVE = ("OSQP_SOLVED", "OSQP_PRIMAL_INFEASIBLE", "OSQP_DUAL_INFEASIBLE")


def _code(name: str) -> int:
    """OSQP's number of a named code."""
    import osqp

    return int(getattr(osqp.SolverStatus, name))


@dataclass(frozen=True)
class QuadraticSolution:
    """OSQP's solution of the quadratic form; zeros without one."""

    x: np.ndarray
    y: np.ndarray
    objective: float
    """Optimal value of the quadratic form: an upper bound of the given program's."""
    code: int
    """OSQP's code, see ``status_of``."""
    iterations: int


@dataclass(frozen=True)
class _Attempt:
    """Settings of one attempt."""

    scaling: int
    """Rounds of OSQP's own scaling; zero keeps the units of the quadratic form."""
    iterations: int
    """Steps allowed in each round."""
    curvature: float = 0.0
    """Curvature of the proximal term; at zero a single round solves the problem."""


_ATTEMPTS = (
    _Attempt(scaling=0, iterations=1_000),
    _Attempt(scaling=10, iterations=10_000),
    _Attempt(scaling=0, iterations=2_000, curvature=0.1),
)


class OSQP(eqx.Module):
    """OSQP on the quadratic form; runs on the host, also under ``jit`` and ``vmap`` (batch elements in sequence).

    ``ConicSolution.objective`` is the given program's cost at OSQP's z, comparable with other solvers.
    ``solve_quadratic`` has the optimal value of the quadratic form, whose norms cost more.
    ``ConicSolution.multipliers`` are the contributions of the quadratic form's rows to stationarity
    (``QuadraticProgram.multipliers``); where norms are active they differ from the given program's.

    Args:
        tolerance: OSQP's absolute and relative tolerance.
        max_iterations: steps allowed in all attempts together.
        facets: sides of the pyramid that replaces a cone of dimension 3.
        polish: whether to solve once more on the estimated active constraints, for a more accurate result.

    Example:
        >>> from jaxscp.conic import OSQP
        >>> from jaxscp.conic.random_programs import smallest_program
        >>> round(float(OSQP()(smallest_program()).objective), 4)
        0.5
    """

    tolerance: float = eqx.field(default=1e-5, static=True)
    max_iterations: int = eqx.field(default=100_000, static=True)
    facets: int = eqx.field(default=DEFAULT_FACETS, static=True)
    polish: bool = eqx.field(default=True, static=True)

    def __call__(
        self,
        program: StagedProgram,
        accuracy: Scalar | float = 0.0,
        warm_start: WarmStart | None = None,
    ) -> ConicSolution:
        """Solution of a program; ``z`` is always finite, ``status`` says how OSQP ended.

        OSQP's own tolerance holds: ``accuracy`` and ``warm_start`` are ignored.
        """
        arrays = (program.gradient, program.links.offset, program.rows.offset)
        like = jax.tree.map(_shape, (*arrays, tuple(cone.offset for cone in program.cones)))
        count = jax.ShapeDtypeStruct((), jnp.int32)
        (z, *multipliers), code, iterations = jax.pure_callback(
            self._on_host, (like, count, count), program, vmap_method="sequential"
        )
        return ConicSolution(
            z, ConicMultipliers(*multipliers), program.objective(z), status_of(code), iterations.astype(int)
        )

    def served_by(self, program: StagedProgram) -> Int[Array, ""]:
        """Index into ``BACKENDS``: OSQP, for every program."""
        return index_of("OSQP")

    def _on_host(self, program: StagedProgram):
        form, solution = self.solve_quadratic(program)
        arrays = (form.node_variables(solution.x), *form.multipliers(solution.y))
        return arrays, np.int32(solution.code), np.int32(solution.iterations)

    def solve_quadratic(self, program: StagedProgram) -> tuple[QuadraticProgram, QuadraticSolution]:
        """Quadratic form of a concrete program, and OSQP's solution of it."""
        form = quadratic_form(program, self.facets)
        return form, self._solve(form)

    def _solve(self, form: QuadraticProgram) -> QuadraticSolution:
        solution = _no_solution(form, _code("OSQP_UNSOLVED"))
        if not all(np.all(np.isfinite(v)) for v in (form.P.data, form.q, form.A.data, form.u)):
            return solution
        spent = 0
        for attempt in _ATTEMPTS:
            solution = self._attempt(form, attempt, self.max_iterations - spent)
            spent += solution.iterations
            if solution.code in map(_code, _DECISIVE) or spent >= self.max_iterations:
                break
        return replace(solution, iterations=spent)

    def _attempt(self, form: QuadraticProgram, attempt: _Attempt, budget: int) -> QuadraticSolution:
        """Result of one round, or with curvature of proximal-point rounds until x converges."""
        curvature = np.zeros(form.q.size)
        curvature[: form.centre.size] = attempt.curvature
        solver = self._set_up(form, attempt, curvature, min(attempt.iterations, budget))
        x, spent, residual = np.zeros(form.q.size), 0, np.inf
        while residual > self.tolerance and spent < budget:
            result = solver.solve(raise_error=False)
            code, spent = int(result.info.status_val), spent + int(result.info.iter)
            if not _is_finite(result):
                return _no_solution(form, code, spent)
            # The gradient of the proximal term is the dual residual of the problem without this term.
            residual = np.max(np.abs(curvature * (result.x - x)))
            if attempt.curvature > 0.0 and code != _code("OSQP_SOLVED"):
                residual = np.inf
            x = result.x
            solver.update(q=form.q - curvature * x)
        if residual > self.tolerance:
            code = _code("OSQP_MAX_ITER_REACHED")
        return QuadraticSolution(x, result.y, form.objective(x), code, spent)

    def _set_up(self, form: QuadraticProgram, attempt: _Attempt, curvature: np.ndarray, iterations: int):
        import osqp  # slow to import

        solver = osqp.OSQP()
        solver.setup(
            (form.P + scipy.sparse.diags(curvature)).tocsc(),
            form.q,
            form.A,
            form.l,
            form.u,
            eps_abs=self.tolerance,
            eps_rel=self.tolerance,
            max_iter=iterations,
            scaling=attempt.scaling,
            polishing=self.polish,
            verbose=False,
        )
        return solver


def _is_finite(result) -> bool:
    return result.x is not None and bool(np.all(np.isfinite(result.x)) and np.all(np.isfinite(result.y)))


def status_of(code) -> StatusCode:
    """Status for one of OSQP's codes."""
    return reduce(
        lambda status, name: Status.where(code == _code(name), _STATUS_OF_CODE[name], status),
        _STATUS_OF_CODE,
        Status.insufficient_progress,
    )


def _no_solution(form: QuadraticProgram, code: int, iterations: int = 0) -> QuadraticSolution:
    return QuadraticSolution(np.zeros(form.q.size), np.zeros(form.u.size), np.inf, code, iterations)


def _shape(array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(array.shape, array.dtype)
