"""OSQP on the quadratic form of a program: the interior point's interface, on the host.

An operator-splitting method: thousands of cheap iterations to moderate accuracy. It serves as an independent
second opinion, and wherever a plain quadratic program is wanted.

It is quick where the cost is curved, slow where it is linear, as in the paper's mode, and proves infeasibility
best when it scales the problem itself, which slows the rest. So there are three attempts, in the order of their
cost, and the first that decides ends the matter; the last is the proximal-point method, each of whose rounds
adds curvature about the round before and so is quick again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxscp.conic.program import ConicMultipliers, ConicSolution, StagedProgram, WarmStart
from jaxscp.conic.quadratic import DEFAULT_FACETS, QuadraticProgram, quadratic_form
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.types import Scalar

# OSQP's own codes and what they are here; any other (a time limit, an interrupt) is too little progress.
_MEANING = {
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
    """OSQP's number for one of its names."""
    import osqp

    return int(getattr(osqp.SolverStatus, name))


@dataclass(frozen=True)
class QuadraticSolution:
    """OSQP's answer to the quadratic form; zeros where it has none."""

    x: np.ndarray
    y: np.ndarray
    objective: float
    """Optimal value of the quadratic form: an upper bound of the given program's."""
    code: int
    """One of OSQP's own, see ``status_of``."""
    iterations: int


@dataclass(frozen=True)
class _Attempt:
    """One way to run OSQP."""

    scaling: int
    """Rounds of OSQP's own scaling; none keeps the units of the quadratic form."""
    iterations: int
    """Steps allowed in each round."""
    curvature: float = 0.0
    """Of the proximal term; without one, a single round solves the problem."""


_ATTEMPTS = (
    _Attempt(scaling=0, iterations=1_000),
    _Attempt(scaling=10, iterations=10_000),
    _Attempt(scaling=0, iterations=2_000, curvature=0.1),
)


class OSQP(eqx.Module):
    """OSQP on the quadratic form; runs on the host, also under ``jit`` and ``vmap`` (one lane after another).

    ``ConicSolution.objective`` is the given program's cost of OSQP's z, so it compares with other solvers';
    the optimal value of the quadratic form itself, which prices norms higher, is that of ``solve_quadratic``.
    ``ConicSolution.multipliers`` are what the rows of the quadratic form contribute to stationarity, see
    ``QuadraticProgram.multipliers``; where norms are active they differ from the given program's.

    Args:
        tolerance: OSQP's absolute and relative tolerance.
        max_iterations: steps allowed in all.
        facets: sides of the pyramid that stands for a cone of dimension 3.
        polish: whether to solve once more on the guessed active constraints, for a more accurate answer.

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
        self, program: StagedProgram, accuracy: Scalar | float = 0.0, near: WarmStart | None = None
    ) -> ConicSolution:
        """Solve a program, to the tolerance whatever accuracy is enough and wherever the solution is thought to be;
        ``z`` is always finite, ``status`` says what it is worth."""
        given = (program.gradient, program.links.offset, program.rows.offset)
        like = jax.tree.map(_shape, (*given, tuple(cone.offset for cone in program.cones)))
        count = jax.ShapeDtypeStruct((), jnp.int32)
        (z, *multipliers), code, iterations = jax.pure_callback(
            self._on_host, (like, count, count), program, vmap_method="sequential"
        )
        return ConicSolution(
            z, ConicMultipliers(*multipliers), program.objective(z), status_of(code), iterations.astype(int)
        )

    def _on_host(self, program: StagedProgram):
        form, answer = self.solve_quadratic(program)
        found = (form.node_variables(answer.x), *form.multipliers(answer.y))
        return found, np.int32(answer.code), np.int32(answer.iterations)

    def solve_quadratic(self, program: StagedProgram) -> tuple[QuadraticProgram, QuadraticSolution]:
        """The quadratic form of a concrete program, and OSQP's answer to it."""
        form = quadratic_form(program, self.facets)
        return form, self._solve(form)

    def _solve(self, form: QuadraticProgram) -> QuadraticSolution:
        answer = _nothing(form, _code("OSQP_UNSOLVED"))
        if not all(np.all(np.isfinite(v)) for v in (form.P.data, form.q, form.A.data, form.u)):
            return answer
        spent = 0
        for attempt in _ATTEMPTS:
            answer = self._attempt(form, attempt, self.max_iterations - spent)
            spent += answer.iterations
            if answer.code in map(_code, _DECISIVE) or spent >= self.max_iterations:
                break
        return replace(answer, iterations=spent)

    def _attempt(self, form: QuadraticProgram, attempt: _Attempt, budget: int) -> QuadraticSolution:
        """One round, or with curvature proximal-point rounds until one does not move."""
        curvature = np.zeros(form.q.size)
        curvature[: form.centre.size] = attempt.curvature
        solver = self._set_up(form, attempt, curvature, min(attempt.iterations, budget))
        x, spent, lack = np.zeros(form.q.size), 0, np.inf
        while lack > self.tolerance and spent < budget:
            found = solver.solve(raise_error=False)
            code, spent = int(found.info.status_val), spent + int(found.info.iter)
            if not _is_finite(found):
                return _nothing(form, code, spent)
            # The proximal term's gradient is what a round's answer lacks of solving the problem itself.
            lack = np.max(np.abs(curvature * (found.x - x)))
            if attempt.curvature > 0.0 and code != _code("OSQP_SOLVED"):
                lack = np.inf
            x = found.x
            solver.update(q=form.q - curvature * x)
        if lack > self.tolerance:
            code = _code("OSQP_MAX_ITER_REACHED")
        return QuadraticSolution(x, found.y, form.objective(x), code, spent)

    def _set_up(self, form: QuadraticProgram, attempt: _Attempt, curvature: np.ndarray, iterations: int):
        import osqp  # here, since it is slow to import

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


def _is_finite(found) -> bool:
    return found.x is not None and bool(np.all(np.isfinite(found.x)) and np.all(np.isfinite(found.y)))


def status_of(code) -> StatusCode:
    """The status that one of OSQP's codes stands for."""
    return reduce(
        lambda found, name: Status.where(code == _code(name), _MEANING[name], found),
        _MEANING,
        Status.insufficient_progress,
    )


def _nothing(form: QuadraticProgram, code: int, iterations: int = 0) -> QuadraticSolution:
    return QuadraticSolution(np.zeros(form.q.size), np.zeros(form.u.size), np.inf, code, iterations)


def _shape(array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(array.shape, array.dtype)
