"""OSQP on the quadratic form of a program: the interior point's interface, on the host.

An operator-splitting method: thousands of cheap iterations to moderate accuracy. It serves as an independent
second opinion, and wherever a plain quadratic program is wanted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import osqp

from jaxscp.conic.program import ConicSolution, Multipliers, StagedProgram
from jaxscp.conic.quadratic import DEFAULT_FACETS, QuadraticProgram, quadratic_form
from jaxscp.status import Status, StatusCode

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
_CODE = {name: int(getattr(osqp.SolverStatus, name)) for name in _MEANING}


@dataclass(frozen=True)
class QuadraticSolution:
    """OSQP's answer to the quadratic form; zeros where it has none."""

    x: np.ndarray
    y: np.ndarray
    objective: float
    """Optimal value of the quadratic form: an upper bound of the given program's."""
    code: int
    """A member of ``osqp.SolverStatus``."""
    iterations: int


class OSQP(eqx.Module):
    """OSQP on the quadratic form; runs on the host, also under ``jit`` and ``vmap`` (one lane after another).

    ``ConicSolution.objective`` is the given program's cost of OSQP's z, so it compares with other solvers';
    the optimal value of the quadratic form itself, which prices norms higher, is that of ``solve_quadratic``.
    ``ConicSolution.multipliers`` are what the rows of the quadratic form contribute to stationarity, see
    ``QuadraticProgram.multipliers``; where norms are active they differ from the given program's.

    Args:
        tolerance: OSQP's absolute and relative tolerance.
        max_iterations: steps allowed.
        facets: sides of the pyramid that stands for a cone of dimension 3.
        polish: whether to solve once more on the guessed active constraints, for a more accurate answer.

    Example:
        >>> from jaxscp.conic import OSQP
        >>> from jaxscp.conic.examples import smallest_program
        >>> round(float(OSQP()(smallest_program()).objective), 4)
        0.5
    """

    tolerance: float = eqx.field(default=1e-5, static=True)
    max_iterations: int = eqx.field(default=50_000, static=True)
    facets: int = eqx.field(default=DEFAULT_FACETS, static=True)
    polish: bool = eqx.field(default=True, static=True)

    def __call__(self, program: StagedProgram) -> ConicSolution:
        """Solve a program; ``z`` is always finite, ``status`` says what it is worth."""
        given = (program.gradient, program.links.offset, program.rows.offset)
        like = jax.tree.map(_shape, (*given, tuple(cone.offset for cone in program.cones)))
        count = jax.ShapeDtypeStruct((), jnp.int32)
        (z, *multipliers), code, iterations = jax.pure_callback(
            self._on_host, (like, count, count), program, vmap_method="sequential"
        )
        return ConicSolution(z, Multipliers(*multipliers), program.objective(z), status_of(code), iterations)

    def _on_host(self, program: StagedProgram):
        form, answer = self.solve_quadratic(program)
        found = (form.node_variables(answer.x), *form.multipliers(answer.y))
        return found, np.int32(answer.code), np.int32(answer.iterations)

    def solve_quadratic(self, program: StagedProgram) -> tuple[QuadraticProgram, QuadraticSolution]:
        """The quadratic form of a concrete program, and OSQP's answer to it."""
        form = quadratic_form(program, self.facets)
        return form, self._solve(form)

    def _solve(self, form: QuadraticProgram) -> QuadraticSolution:
        if not all(np.all(np.isfinite(v)) for v in (form.P.data, form.q, form.A.data, form.u)):
            return _nothing(form, _CODE["OSQP_UNSOLVED"], 0)
        solver = osqp.OSQP()
        solver.setup(
            form.P,
            form.q,
            form.A,
            form.l,
            form.u,
            eps_abs=self.tolerance,
            eps_rel=self.tolerance,
            max_iter=self.max_iterations,
            polishing=self.polish,
            scaling=0,  # the rows' units are chosen in the quadratic form; Ruiz scaling undoes that
            verbose=False,
        )
        answer = solver.solve(raise_error=False)
        code, iterations = int(answer.info.status_val), int(answer.info.iter)
        if answer.x is None or not (np.all(np.isfinite(answer.x)) and np.all(np.isfinite(answer.y))):
            return _nothing(form, code, iterations)
        return QuadraticSolution(answer.x, answer.y, form.objective(answer.x), code, iterations)


def status_of(code) -> StatusCode:
    """The status that one of OSQP's codes stands for."""
    return reduce(
        lambda found, name: Status.where(code == _CODE[name], _MEANING[name], found),
        _MEANING,
        Status.insufficient_progress,
    )


def _nothing(form: QuadraticProgram, code: int, iterations: int) -> QuadraticSolution:
    return QuadraticSolution(np.zeros(form.q.size), np.zeros(form.u.size), np.inf, code, iterations)


def _shape(array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(array.shape, array.dtype)
