"""Certificate: an independent check of a solution, without the solver's discretisation (see ``integrator``).

The planned controls are integrated again from the initial state to the end, without correction, by an adaptive
eighth-order method at a tight tolerance. The constraints are then evaluated on that rollout, densely between the nodes,
in their own units.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.constraint import DISTANCE_TOLERANCE, Constraint
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.rollout import Rollout, rollout

OPTIMALITY_TOLERANCE = 0.3  # KKT residual; converged solutions have about 0.01
ANGLE_TOLERANCE = 1.75e-3  # rad (0.1 degree), error of the final attitude


class Certificate(eqx.Module):
    """Errors and violations of a solution; zero or positive, in each constraint's own unit.

    All values are infinite if the integration fails.
    """

    defect: Scalar
    """Largest distance between the planned and the integrated state at a node, all states in one norm."""
    position_error: Scalar
    """m, of the integrated end from the goal, in the fixed components."""
    velocity_error: Scalar
    """m/s, likewise."""
    attitude_error: Scalar
    """rad, likewise."""
    rate_error: Scalar
    """rad/s, likewise."""
    at_nodes: Float[Array, "constraints"]
    """Worst violation at the nodes, for each constraint in the order of ``names``."""
    between_nodes: Float[Array, "constraints"]
    """Worst violation over dense samples of the whole rollout."""
    allowed: Float[Array, "constraints"]
    """Violation that counts as none: 1 mm for distances, 1e-3 of a limit or of the range between two."""
    optimality: Scalar | None
    """KKT residual of the nonlinear problem (``stationarity``); None for a method that claims no optimum."""
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def violation(self) -> Scalar:
        """Worst violation of any constraint over the whole rollout."""
        return jnp.max(self.between_nodes, axis=-1)

    def passed(self, between_nodes: bool = True) -> Flag:
        """Whether the solution is good enough: end, constraints and optimality within their tolerances.

        The integrated end must lie within 1 mm and 0.1 degree of the goal. No constraint may be violated by more than
        ``allowed``. The KKT residual, if there is one, must be below ``OPTIMALITY_TOLERANCE``.

        Args:
            between_nodes: whether constraints count; a method that enforces them only at nodes claims less.
        """
        good = (self.position_error <= DISTANCE_TOLERANCE) & (self.attitude_error <= ANGLE_TOLERANCE)
        if self.optimality is not None:
            good &= self.optimality <= OPTIMALITY_TOLERANCE
        return good & jnp.all(self.between_nodes <= self.allowed) if between_nodes else good

    def report(self) -> str:
        """A short text for people; for one solution, not a batch."""
        lines = [
            f"integrated end: {1e3 * float(self.position_error):.3g} mm, "
            f"{float(jnp.degrees(self.attitude_error)):.3g} deg, {float(self.velocity_error):.3g} m/s, "
            f"{float(self.rate_error):.3g} rad/s from the goal",
            f"largest defect {float(self.defect):.3g}",
        ]
        if self.optimality is not None:
            lines.append(f"KKT residual {float(self.optimality):.3g}, relative to the cost")
        width = max(map(len, self.names))
        for name, nodes, between in zip(self.names, self.at_nodes, self.between_nodes, strict=True):
            lines.append(
                f"{name:<{width}}  violated by {float(nodes):.3g} at nodes, {float(between):.3g} between"
            )
        return "\n".join(lines)


def certify(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    samples: int = 200,
    optimality: Scalar | None = None,
) -> Certificate:
    """Certificate of a rigid-body trajectory for its problem.

    Args:
        problem: that was solved.
        trajectory: the solution; only its controls, its dilation and its first state are used. ``problem.final``
            must be a condition on (position, velocity, attitude by 3 or 4 components, body rate).
        samples: points an interval at which constraints are evaluated, two at least.
        optimality: KKT residual, if the method claims an optimum.
    """
    integrated = rollout(problem, trajectory, samples)
    missed = problem.final.function(integrated.state[-1, -1], trajectory.time[-1], problem.final.parameters)
    defect = jnp.max(jnp.linalg.norm(integrated.state[:, -1] - trajectory.state[1:], axis=-1))
    violations = [_violations(c, trajectory, integrated) for c in problem.constraints]
    certificate = Certificate(
        defect=defect,
        position_error=jnp.linalg.norm(missed[:3]),
        velocity_error=jnp.linalg.norm(missed[3:6]),
        attitude_error=_angle(missed[6:-3]),
        rate_error=jnp.linalg.norm(missed[-3:]),
        at_nodes=jnp.stack([at_nodes for at_nodes, _ in violations]),
        between_nodes=jnp.stack([between for _, between in violations]),
        allowed=jnp.stack([jnp.asarray(c.allowed, float) for c in problem.constraints]),
        optimality=optimality,
        names=tuple(c.name for c in problem.constraints),
    )
    return jax.tree.map(lambda v: jnp.where(jnp.isnan(v), jnp.inf, v), certificate)


def _angle(missed: Float[Array, "_"]) -> Scalar:
    """Angle of a rotation, from the residual of its end condition.

    The residual is the difference of two quaternions (4,), of length 2 sin(angle / 4), or a vector part (3,), of length
    sin(angle / 2).
    """
    length = jnp.linalg.norm(missed)
    if missed.shape[0] == 4:
        return 4.0 * jnp.arcsin(jnp.minimum(0.5 * length, 1.0))
    return 2.0 * jnp.arcsin(jnp.minimum(length, 1.0))


def _planned_nodes(trajectory: Trajectory) -> Rollout:
    return Rollout(trajectory.time[:, None], trajectory.state[:, None], trajectory.control[:, None])


def _integrated_nodes(trajectory: Trajectory, integrated: Rollout) -> Rollout:
    """The nodes of the rollout."""
    state = jnp.concatenate([integrated.state[:, :1], integrated.state[-1:, -1:]])
    return Rollout(trajectory.time[:, None], state, trajectory.control[:, None])


def _worst(constraint: Constraint, integrated: Rollout) -> Scalar:
    """Worst violation on a rollout; interval k has the parameters of node k."""
    count = integrated.time.shape[0]

    def violation(state, control, time, parameters):
        return constraint.cone.violation(constraint.function(state, control, time, parameters))

    over_samples = jax.vmap(violation, in_axes=(0, 0, 0, None))
    parameters = jax.tree.map(lambda p: p[:count], constraint.parameters)
    values = jax.vmap(over_samples)(integrated.state, integrated.control, integrated.time, parameters)
    active = constraint.active[:count]
    return jnp.max(jnp.where(active[:, None], values, 0.0), initial=0.0)


def _worst_across(constraint: Constraint, trajectory: Trajectory) -> Scalar:
    """Worst violation of a constraint on the controls at both ends of every interval."""
    intervals = trajectory.time.shape[0] - 1
    controls = jnp.concatenate([trajectory.control, trajectory.dilation[:, None]], axis=1)
    parameters = jax.tree.map(lambda p: p[:-1], constraint.parameters)

    def violation(first, last, parameters):
        return constraint.cone.violation(constraint.function(first, last, 1.0 / intervals, parameters))

    values = jax.vmap(violation)(controls[:-1], controls[1:], parameters)
    return jnp.max(jnp.where(constraint.active[:-1], values, 0.0), initial=0.0)


def _violations(constraint: Constraint, trajectory: Trajectory, integrated: Rollout) -> tuple[Scalar, Scalar]:
    """Worst violation at the nodes, and wherever the constraint must hold."""
    if constraint.where.across:
        worst = _worst_across(constraint, trajectory)
        return worst, worst
    at_nodes = _worst(constraint, _planned_nodes(trajectory))
    where = _integrated_nodes(trajectory, integrated) if constraint.where.nodal else integrated
    return at_nodes, _worst(constraint, where)
