"""Certificate: an independent check of a solution, without the solver's discretisation (see ``integrator``).

The planned controls are integrated again from the initial state to the end, without correction, by an adaptive
eighth-order method at a tight tolerance. The constraints are then evaluated on that rollout, densely between the nodes.
Every row has the name and the unit that the problem gives it.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscp.core.obstacles import Hull
from jaxscp.core.types import Scalar
from jaxscp.problem.canonical import canonical
from jaxscp.problem.constraint import DISTANCE_TOLERANCE
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.sizes import end_measures
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.clearance import clearance
from jaxscp.verification.report import report
from jaxscp.verification.rollout import Rollout, rollout
from jaxscp.verification.trajectory_check import check_trajectory
from jaxscp.verification.violations import violations_of

OPTIMALITY_TOLERANCE = 0.3  # KKT residual; converged solutions have about 0.01


class Certificate(eqx.Module):
    """Errors and violations of a solution; zero or positive, in the unit of each row. A hull has a clearance, too.

    All values are infinite if the integration fails.
    """

    defect: Scalar
    """Largest distance between the planned and the integrated state at a node, all states in one norm."""
    end_errors: Float[Array, "ends"]
    """Of the planned start and the integrated end, in the order of ``end_names``."""
    end_tolerances: Float[Array, "ends"]
    """Error that counts as none."""
    at_nodes: Float[Array, "constraints"]
    """Worst violation at the nodes, for each constraint in the order of ``names``."""
    between_nodes: Float[Array, "constraints"]
    """Worst violation over dense samples of the whole rollout."""
    allowed: Float[Array, "constraints"]
    """Violation that counts as none; infinite for a soft constraint."""
    optimality: Scalar | None
    """KKT residual of the nonlinear problem (``stationarity``); None for a method that claims no optimum."""
    names: tuple[str, ...] = eqx.field(static=True)
    """Of the constraints, then of the problem's checks."""
    end_names: tuple[str, ...] = eqx.field(static=True)
    """``"initial position"``, say."""
    end_units: tuple[str, ...] = eqx.field(static=True)
    clearance: Scalar | None = None
    """Distance of the hull to the nearest obstacle point over the whole path, at least, in metres; negative where a
    point is in the hull, and minus infinity if the integration fails. None if no obstacles are known."""

    @property
    def violation(self) -> Scalar:
        """Worst violation of any constraint over the whole rollout; zero without constraints."""
        hard = jnp.where(jnp.isinf(self.allowed), 0.0, self.between_nodes)
        return jnp.max(hard, axis=-1, initial=0.0)

    def error(self, name: str) -> Float[Array, "*batch"]:
        """Error at an end, by its name: ``certificate.error("final position")``.

        Raises:
            KeyError: if no row has this name; the message lists the names.
        """
        if name not in self.end_names:
            raise KeyError(f"no row {name!r}; there are {', '.join(self.end_names) or 'none'}")
        return self.end_errors[..., self.end_names.index(name)]

    def passed(self, between_nodes: bool = True, optimum: bool = True) -> Bool[Array, "*batch"]:
        """Whether each solution is good enough: ends, constraints, clearance and optimality within their tolerances.

        Args:
            between_nodes: whether constraints count; a method that enforces them only at nodes claims less.
            optimum: whether optimality counts; without it, a flight that keeps all constraints passes.
        """
        good = jnp.all(self.end_errors <= self.end_tolerances, axis=-1)
        if self.clearance is not None:
            good &= self.clearance >= -DISTANCE_TOLERANCE
        if optimum and self.optimality is not None:
            good &= self.optimality <= OPTIMALITY_TOLERANCE
        return good & jnp.all(self.between_nodes <= self.allowed, axis=-1) if between_nodes else good

    def largest_row(self, between_nodes: bool = True) -> str:
        """The row that is furthest beyond its tolerance, in words; empty if none is. For one solution, not a batch.

        Args:
            between_nodes: whether constraints count, as in ``passed``.
        """
        names = (*self.end_names, *self.names, "clearance")
        overlap = 0.0 if self.clearance is None else max(-float(self.clearance), 0.0)
        between = self.between_nodes if between_nodes else np.zeros(len(self.names))
        values = np.concatenate([self.end_errors, between, [overlap]])
        allowed = np.concatenate([self.end_tolerances, self.allowed, [DISTANCE_TOLERANCE]])
        ratios = np.nan_to_num(values / allowed, posinf=np.inf)
        if not (ratios > 1.0).any():
            return ""
        row = int(np.argmax(ratios))
        return f"{names[row]}, off by {values[row]:.3g}, which is {ratios[row]:.3g} times its tolerance"

    def report(self) -> str:
        """A short text for people; of a batch, a row has the worst element's value and its index."""
        return report(self)


def certify(
    problem: OptimalControlProblem | ScaledTimeProblem,
    trajectory: Trajectory,
    samples: int = 200,
    optimality: Scalar | None = None,
    hull: Hull | None = None,
) -> Certificate:
    """Certificate of a trajectory for its problem.

    Args:
        problem: that was solved; typical sizes of a problem with a scale are measured on the trajectory.
        trajectory: the solution; only its controls, its dilation and its first state are used.
        samples: points an interval at which constraints are evaluated, two at least.
        optimality: KKT residual, if the method claims an optimum.
        hull: the vehicle among known obstacles, ``scenario.hull(solution.context)`` say.

    Raises:
        InvalidProblem: the trajectory is of another problem: other sizes, held controls, or final time. Times that are
            traced are not compared.

    Example:
        >>> import jaxscp
        >>> scenario = jaxscp.scenarios.ascent_to_platform()
        >>> solution = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))(scenario)
        >>> problem, _ = scenario.problem(10, context=solution.context)
        >>> jaxscp.certify(problem, solution.trajectory, samples=20).names
        ('corridor', 'thrust', 'landing cone')
    """
    if isinstance(problem, OptimalControlProblem):
        check_trajectory(problem, trajectory)
        plan = trajectory.with_dynamics(None)
        stated = over_scaled_time(canonical(problem), Continuous(), plan)
        return _compiled(stated, plan, samples, optimality, hull)
    return _certificate(problem, trajectory, samples, optimality, hull)


def _certificate(
    problem: ScaledTimeProblem,
    trajectory: Trajectory,
    samples: int,
    optimality: Scalar | None,
    hull: Hull | None,
) -> Certificate:
    integrated = rollout(problem, trajectory, samples)
    defect = jnp.max(jnp.linalg.norm(integrated.state[:, -1] - trajectory.state[1:], axis=-1))
    ends = _end_rows(problem, trajectory, integrated)
    constraints = (*problem.constraints, *problem.checks)
    violations = [violations_of(c, trajectory, integrated, problem.sizes) for c in constraints]
    certificate = Certificate(
        defect=_or_infinite(defect),
        end_errors=_errors([error for *_, error, _ in ends]),
        end_tolerances=_stacked([tolerance for *_, tolerance in ends]),
        at_nodes=_errors([at_nodes for at_nodes, *_ in violations]),
        between_nodes=_errors([between for _, between, _ in violations]),
        allowed=_stacked([allowed for *_, allowed in violations]),
        optimality=None if optimality is None else _or_infinite(optimality),
        names=tuple(c.name for c in constraints),
        end_names=tuple(name for name, *_ in ends),
        end_units=tuple(unit for _, unit, *_ in ends),
    )
    return (
        certificate
        if hull is None
        else dataclasses.replace(certificate, clearance=clearance(hull, integrated))
    )


_compiled = eqx.filter_jit(_certificate)


def _or_infinite(error: Array) -> Array:
    """An error that is no number counts as infinite."""
    return jnp.where(jnp.isnan(error), jnp.inf, error)


def _stacked(values: list) -> Float[Array, "rows"]:
    return jnp.stack([jnp.asarray(v, float) for v in values]) if values else jnp.zeros(0)


def _errors(values: list) -> Float[Array, "rows"]:
    return _or_infinite(_stacked(values))


def _end_rows(
    problem: ScaledTimeProblem, trajectory: Trajectory, integrated: Rollout
) -> list[tuple[str, str, Scalar, Scalar]]:
    """(name, unit, error, tolerance) of every group of rows: at the start, at the end, and on both."""
    boundary, found = problem.boundary, []
    first, last, time = trajectory.state[0], integrated.state[-1, -1], trajectory.time[-1]
    values = {
        "initial": boundary.initial.value(first, trajectory.time[0]),
        "final": boundary.final.value(last, time),
    }
    if boundary.coupled is not None:
        values["coupled"] = boundary.coupled.value(first, last, time)
    measures = end_measures(boundary, problem.sizes)
    for where, value in values.items():
        before = 0
        for rows, measure in zip(getattr(boundary, where).rows, measures.get(where, []), strict=True):
            error = rows.error(measure.weights * value[before : before + rows.count])
            found.append((f"{where} {rows.name}", rows.unit, error, measure.tolerance))
            before += rows.count
    return found
