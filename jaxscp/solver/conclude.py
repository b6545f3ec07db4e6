"""From the result of a method to a certified solution, in the user's units."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscp.core import batching
from jaxscp.core.implicit import undefined_unless
from jaxscp.core.obstacles import Hull
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.scp.history import History
from jaxscp.scp.method import Method, MethodResult
from jaxscp.solver.scenario import Units
from jaxscp.solver.sized import Sized
from jaxscp.solver.solution import Solution
from jaxscp.transcription.gradient import gradient_by
from jaxscp.transcription.layout import trajectory_of
from jaxscp.transcription.stationarity import stationarity
from jaxscp.verification.certificate import Certificate, certify
from jaxscp.verification.integrator.method import eighth_order

CERTIFICATE_CHUNK = (4096,)  # batch elements certified at once on a GPU, which takes as long for fewer


class Reported(eqx.Module):
    """The problem in the user's units, which a solution is asked by and given in."""

    problem: ScaledTimeProblem
    units: Units
    """Of the solver."""


class Measures(eqx.Module):
    """What a certificate measures by."""

    sized: Sized | None
    """Sizes in which the solution was found; None if the problem's units are good."""
    hull: Hull | None
    """The vehicle among known obstacles, in the user's units; None if there are none."""


def conclude(
    method: Method,
    samples: int,
    problem: ScaledTimeProblem,
    result: MethodResult,
    context: Any,
    reported: Reported | None,
    measures: Measures,
) -> Solution:
    """The solution with its certificate.

    Args:
        method: that was used.
        samples: points an interval at which the certificate checks the constraints.
        problem: that was solved.
        result: of the method.
        context: of the scenario, or None.
        reported: the problem in the user's units; None if it is the one that was solved.
        measures: of the certificate.
    """
    trajectory, multipliers, z = trajectory_of(problem, result.z), result.multipliers, result.z
    if reported is not None:
        trajectory = reported.units.trajectory(trajectory)
        z = reported.problem.join(trajectory.state, trajectory.control, trajectory.dilation)
        if multipliers is not None:
            multipliers = reported.units.multipliers(problem, multipliers)
    asked = problem if reported is None else reported.problem
    frozen = jax.lax.stop_gradient((problem, result, asked, trajectory, measures))
    certificate = batching.in_chunks(
        lambda fixed: _certificate(method, samples, *fixed), frozen, CERTIFICATE_CHUNK
    )
    return Solution(
        status=_status(result.status, certificate, method.holds_between_nodes),
        trajectory=trajectory.with_dynamics(asked.dynamics),
        cost=result.cost * _sizes(problem, reported)[0],
        final_time=trajectory.time[-1],
        iterations=result.iterations,
        interior_point_iterations=result.interior_point_iterations,
        differentiable=result.is_optimum,
        multipliers=multipliers,
        certificate=certificate,
        history=_in_units(result.history, *_sizes(problem, reported)),
        backends=result.backends,
        z=z,
        context=context,
        fell_back=jnp.zeros((), bool),
        recovers=jnp.zeros((), bool),
    )


def solution_if_valid(ok: Flag, solution: Solution) -> Solution:
    """NaN in every float and every derivative, and ``invalid_input``, for an element that is not valid."""
    floats, rest = eqx.partition(solution, eqx.is_inexact_array)
    rest = jax.tree.map(lambda v: jnp.where(ok, v, jnp.zeros_like(v)), rest)
    found = eqx.combine(undefined_unless(ok, floats), rest)
    return eqx.tree_at(lambda s: s.status, found, Status.where(ok, solution.status, Status.invalid_input))


def _status(status: StatusCode, certificate: Certificate, between_nodes: bool) -> StatusCode:
    """The status by the certificate: it may refute a claim to have converged, and one to have found no flight."""
    failed = (status == Status.converged) & ~certificate.passed(between_nodes)
    unmet = (status == Status.dynamics_unmet) | (status == Status.constraints_unmet)
    flies = unmet & certificate.passed(optimum=False)  # at last: the dynamics were restored
    status = Status.where(flies, Status.insufficient_progress, status)
    return Status.where(failed, Status.verification_failed, status)


def _sizes(problem: ScaledTimeProblem, reported: Reported | None) -> tuple[Scalar | float, Scalar | float]:
    """Sizes of the solver's units of cost and of time."""
    if reported is not None:
        return reported.units.cost, reported.units.time
    return (1.0, 1.0) if problem.sizes is None else (problem.sizes.cost, problem.sizes.time)


def _in_units(history: History, cost: Scalar | float, time: Scalar | float) -> History:
    """The history with costs and times in the user's units; the other columns are relative to typical sizes."""
    parts = history.cost * cost, history.objective * cost, history.final_time * time
    return eqx.tree_at(lambda h: (h.cost, h.objective, h.final_time), history, parts)


def _certificate(
    method: Method,
    samples: int,
    problem: ScaledTimeProblem,
    result: MethodResult,
    asked: ScaledTimeProblem,
    trajectory: Trajectory,
    measures: Measures,
) -> Certificate:
    """Certificate of a trajectory; with multipliers and a grid, its KKT residual by the verifier's integration.

    It measures by the sizes of the trajectory itself.
    """
    if measures.sized is not None:
        asked = measures.sized.at(trajectory).problem()
    optimality = None
    if result.multipliers is not None and method.grid is not None:
        gradient = gradient_by(eighth_order(), problem, result.z, result.multipliers, method.grid)
        optimality = stationarity(gradient, result.z, result.cost)
    return certify(asked, trajectory, samples, optimality, measures.hull)
