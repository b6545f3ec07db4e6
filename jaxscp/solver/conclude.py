"""From the result of a method to a certified solution, in the user's units."""

from typing import Any

import equinox as eqx
import jax

from jaxscp.core import batching
from jaxscp.core.status import Status
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.scp.method import Method, MethodResult
from jaxscp.solver.solution import Solution
from jaxscp.transcription.layout import trajectory_of
from jaxscp.transcription.stationarity import stationarity
from jaxscp.verification.certificate import Certificate, certify
from jaxscp.verification.gradient import verified_gradient

CERTIFICATE_CHUNK = (4096,)  # batch elements certified at once on a GPU, which takes as long for fewer


def conclude(
    method: Method, samples: int, problem: ScaledTimeProblem, result: MethodResult, context: Any
) -> Solution:
    """The solution with its certificate.

    Args:
        method: that was used.
        samples: points an interval at which the certificate checks the constraints.
        problem: that was solved.
        result: of the method.
        context: of the scenario, or None.
    """
    trajectory = trajectory_of(problem, result.z)
    frozen = jax.lax.stop_gradient((problem, result, trajectory))
    certificate = batching.in_chunks(
        lambda fixed: _certificate(method, samples, *fixed), frozen, CERTIFICATE_CHUNK
    )
    failed = (result.status == Status.converged) & ~certificate.passed(method.holds_between_nodes)
    return Solution(
        status=Status.where(failed, Status.verification_failed, result.status),
        trajectory=trajectory.with_dynamics(problem.dynamics),
        cost=result.cost if problem.sizes is None else result.cost * problem.sizes.cost,
        final_time=trajectory.time[-1],
        iterations=result.iterations,
        interior_point_iterations=result.interior_point_iterations,
        differentiable=result.is_optimum,
        multipliers=result.multipliers,
        certificate=certificate,
        history=_in_units(problem, result.history),
        backends=result.backends,
        z=result.z,
        context=context,
    )


def _in_units(problem: ScaledTimeProblem, history: History) -> History:
    """The history with costs and times in the user's units; the other columns are relative to typical sizes."""
    sizes = problem.sizes
    if sizes is None:
        return history
    parts = history.cost * sizes.cost, history.objective * sizes.cost, history.final_time * sizes.time
    return eqx.tree_at(lambda h: (h.cost, h.objective, h.final_time), history, parts)


def _certificate(
    method: Method,
    samples: int,
    problem: ScaledTimeProblem,
    result: MethodResult,
    trajectory: Trajectory,
) -> Certificate:
    """Certificate of a trajectory; with multipliers and a grid, its KKT residual by the verifier's integration."""
    optimality = None
    if result.multipliers is not None and method.grid is not None:
        gradient = verified_gradient(problem, result.z, result.multipliers, method.grid)
        optimality = stationarity(gradient, result.z, result.cost)
    return certify(problem, trajectory, samples, optimality)
