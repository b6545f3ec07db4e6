"""Convergence test of ``NewtonSCP``: feasibility, predicted decrease and KKT residual, each in its tolerance."""

import equinox as eqx
import jax.numpy as jnp

from jaxscp.core.status import Status, after_failed_subproblem, usable
from jaxscp.core.types import Scalar
from jaxscp.problem.node_values import node_times
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.acceptance import MOST_PROXIMAL
from jaxscp.scp.history import History
from jaxscp.scp.state import NewtonSettings, NewtonState
from jaxscp.scp.subproblem import SubproblemSolution
from jaxscp.transcription.lagrangian import worst_violation
from jaxscp.transcription.stationarity import lagrangian_gradient, stationarity


def check_convergence(
    settings: NewtonSettings,
    problem: ScaledTimeProblem,
    new: NewtonState,
    qp: SubproblemSolution,
    tolerance_factor: Scalar | float,
) -> NewtonState:
    """The state with status and history; the loop may end where ``tolerance_factor`` times the tolerances are met.

    The predicted decrease is the subproblem's own, even after a rejection.
    """
    now = new.residual
    residuals = jnp.stack([now.dynamics, worst_violation(problem, now)]) / settings.tolerance_defect
    dynamics_feasible, constraints_feasible = residuals <= 1.0
    decrease = jnp.abs(qp.decrease) / (settings.tolerance * jnp.maximum(1.0, jnp.abs(now.cost)))
    gradient = lagrangian_gradient(problem, new.z, new.linear, new.multipliers)
    kkt = stationarity(gradient, new.z, now.cost) / settings.tolerance_gradient
    inexactness = qp.forcing / settings.tolerance  # a coarse subproblem leaves its prediction uncertain
    worst = jnp.max(jnp.stack([*residuals, decrease, kkt, inexactness]))
    optimal = new.accepted_with_small_proximal & (worst <= 1.0)
    stuck = new.proximal > MOST_PROXIMAL
    feasible = dynamics_feasible & constraints_feasible
    # From an optimum no step leads down: the interior point has to say that it is one.
    close_to_optimum = (new.accepted_with_small_proximal & (worst <= tolerance_factor)) | (stuck & feasible)
    status = Status.where(constraints_feasible, Status.iteration_limit, Status.constraints_unmet)
    status = Status.where(dynamics_feasible, status, Status.dynamics_unmet)
    status = Status.where(stuck & feasible, Status.insufficient_progress, status)
    ended = after_failed_subproblem(qp.conic.status)
    status = Status.where(stuck & ~usable(qp.conic.status), ended, status)
    row = History(
        cost=now.cost,
        objective=qp.conic.objective,
        final_time=node_times(new.z[:, -1])[-1],
        virtual_control=jnp.max(jnp.linalg.norm(qp.virtual_control, axis=1)),
        step_norm=qp.step_norm,
        defect=jnp.max(jnp.linalg.norm(now.defect, axis=1)),
        conic_iterations=qp.conic.iterations,
    )
    return eqx.tree_at(
        lambda s: (s.cost, s.iterations, s.close_to_optimum, s.status, s.done, s.history),
        new,
        (
            now.cost,
            new.iterations + 1,
            close_to_optimum,
            Status.where(optimal, Status.converged, status),
            close_to_optimum | stuck,
            new.history.with_row(new.iterations, row),
        ),
    )
