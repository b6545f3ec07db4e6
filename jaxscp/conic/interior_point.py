"""Primal-dual interior point for staged conic programs.

The method uses Nesterov-Todd scaling and Mehrotra's predictor and corrector. From a cold start it works in the
homogeneous embedding, which adds two scalars tau and kappa (Goulart and Chen, "Clarabel: an interior-point solver for
conic programs with quadratic objectives", 2024). A solution of the embedding has one of two forms. If tau > 0, x / tau
solves the program. If kappa > 0, the iterate proves that the program is infeasible or unbounded.

A warm start assumes that a solution exists. From there the method works on the program itself, with tau = 1 and
kappa = 0. That takes fewer steps, each with one right-hand side less.

``loop`` has the loop as JAX, ``native`` the same loop in C++ and CUDA.
"""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.backends.libraries import dispatch, serving
from jaxscp.cones.product import ConeVector
from jaxscp.conic import conic_form, native
from jaxscp.conic.conic_form import Primal
from jaxscp.conic.equilibrate import Scales
from jaxscp.conic.iterate import Iterate
from jaxscp.conic.loop import LoopResult, run_loop
from jaxscp.conic.program import ConicMultipliers, ConicSolution, StagedProgram, WarmStart
from jaxscp.conic.settings import Settings
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.types import Scalar


class InteriorPoint(Settings):
    """Structured interior point for staged programs; it runs under ``jit``, ``vmap`` and on any device.

    The Newton system is reduced to one block tridiagonal matrix (``kkt``), so that work and memory grow linearly with
    the number of nodes. In float64, on CPUs and NVIDIA GPUs, the loop runs compiled (``conic.native``) if the library
    was built; otherwise it runs as JAX. It has no derivative; ``ConicLayer`` has one.

    Args:
        tolerance: relative gap and relative residuals below which a program is solved.
        proof_tolerance: relative residual below which a certificate of infeasibility or unboundedness is accepted. At
            1e-6 a certificate still excludes every point of norm below 1e6.
        loose_tolerance: tolerance for ``almost_converged`` when progress ends early.
        max_iterations: Newton steps allowed from each starting point.
        regularisation: added to the diagonal of the equilibrated KKT matrix; refinement removes its effect.
        refinements: rounds of iterative refinement for each right-hand side.
        refine_below: error below which refinement is used. Farther from the end, its digits do not matter.
        equilibration: rounds of Ruiz scaling.
        compiled: whether ``conic.native`` may run the loop.
    """

    def __call__(
        self,
        program: StagedProgram,
        accuracy: Scalar | float = 0.0,
        warm_start: WarmStart | None = None,
    ) -> ConicSolution:
        """Solution of a program.

        Args:
            program: the program to solve.
            accuracy: sufficient relative gap and residuals, if larger than the tolerance. It saves steps whose digits
                an outer iteration does not use.
            warm_start: estimate of the solution. A good one saves steps and makes each step cheaper. If it leads
                nowhere, the loop starts again, cold.

        Returns:
            A ``ConicSolution``; its ``z`` is always finite, its ``status`` says how the loop ended.
        """
        tolerance = jnp.maximum(self.tolerance, jnp.asarray(accuracy, program.gradient.dtype))
        result = self.iterate(program, tolerance, warm_start)
        x, y, _ = result.iterate.solution()
        z, multipliers = restored(program, result.scales, x, y)
        return ConicSolution(
            z, multipliers, program.objective(z), self.status(result, tolerance), result.iterations
        )

    def iterate(
        self,
        program: StagedProgram,
        tolerance: Scalar | float | None = None,
        warm_start: WarmStart | None = None,
    ) -> LoopResult:
        """Result of the loop, in equilibrated units; the default tolerance is the solver's own."""
        tolerance = jnp.asarray(self.tolerance if tolerance is None else tolerance, program.gradient.dtype)
        if warm_start is not None:
            # A start at NaN fails at once, so that the loop starts again, cold.
            z = jnp.where(warm_start.available, warm_start.z, jnp.nan)
            warm_start = eqx.tree_at(lambda n: n.z, warm_start, z)
        arguments = _without_derivative((program, tolerance, warm_start))
        cpp, cuda = self._compiled_for(program)
        return dispatch(
            functools.partial(self._run_compiled, native.call) if cpp else None,
            functools.partial(run_loop, settings=self),
            *arguments,
            cuda=functools.partial(self._run_compiled, native.call_on_gpu) if cuda else None,
        )

    def served_by(self, program: StagedProgram) -> Int[Array, ""]:
        """Index into ``BACKENDS`` of the loop that solves programs of these shapes."""
        cpp, cuda = self._compiled_for(program)
        return serving(cpp=cpp, cuda=cuda)

    def _compiled_for(self, program: StagedProgram) -> tuple[bool, bool]:
        """Whether a program's loop runs as C++, and as a kernel."""
        return self.compiled and native.supports(program), self.compiled and native.supports_on_gpu(program)

    def status(self, result: LoopResult, tolerance: Scalar | float | None = None) -> StatusCode:
        """Status of a result of the loop; the default tolerance is the solver's own."""
        tolerance = self.tolerance if tolerance is None else tolerance
        status = Status.where(
            result.broken,
            Status.numerical_error,
            Status.where(result.stalled, Status.insufficient_progress, Status.iteration_limit),
        )
        status = Status.where(result.error <= self.loose_tolerance, Status.almost_converged, status)
        status = Status.where(result.unboundedness <= self.proof_tolerance, Status.unbounded, status)
        status = Status.where(result.infeasibility <= self.proof_tolerance, Status.infeasible, status)
        return Status.where(result.error <= tolerance, Status.converged, status)

    def _run_compiled(
        self, call, program: StagedProgram, tolerance: Scalar, warm_start: WarmStart | None
    ) -> LoopResult:
        names = [f.name for f in dataclasses.fields(Settings) if f.name not in ("tolerance", "compiled")]
        outputs = call(program, tolerance, warm_start, **{name: getattr(self, name) for name in names})
        z, xi, zeta, y_zero, y_orthant, y_second, s_orthant, s_second, tau, kappa, *outputs = outputs
        error, infeasibility, unboundedness, iterations, stalled, broken, *outputs = outputs
        columns, links, rows, *cones, cost = outputs
        y = ConeVector(y_zero, y_orthant, y_second)
        s = ConeVector(jnp.zeros_like(y_zero), s_orthant, s_second)
        iterate = Iterate(Primal(z, xi, zeta), y, s, tau, kappa)
        scales = Scales(columns, links, rows, tuple(cones), cost)
        return LoopResult(iterate, error, infeasibility, unboundedness, iterations, stalled, broken, scales)


def restored(
    program: StagedProgram, scales: Scales, x: Primal, y: ConeVector
) -> tuple[Float[Array, "nodes variables"], ConicMultipliers]:
    """Node variables and multipliers in the user's units, from a point of the equilibrated program."""
    user, _, _ = conic_form.unpack_cones(program, y.second)
    return scales.restore(
        x.z, ConicMultipliers(conic_form.link_multipliers(program, y), y.orthant, tuple(user))
    )


@jax.custom_jvp
def _without_derivative(arguments):
    """The arguments of the loop, whose derivative is a TypeError on every device."""
    return arguments


@_without_derivative.defjvp
def _refuse(primals, tangents):
    raise TypeError(
        "the interior point has no derivative: jaxscp.conic.ConicLayer is the conic step as a differentiable function; "
        "where none is wanted, give it jax.lax.stop_gradient(program)"
    )
