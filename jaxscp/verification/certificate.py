"""An independent judge of an answer: it shares no code with the solver's discretisation (but see ``flown``).

The planned controls are flown again, from the initial state to the end without correction, by an adaptive
eighth-order method (Dormand and Prince's; ``flown``) at tight tolerance. The constraints are then evaluated on that
flight, densely between the nodes, in their own units.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.cones.cone import NonNegative, SecondOrder
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.constraint import DISTANCE, AcrossIntervals, AtNodes, Constraint
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.rollout import Flight, fly

OPTIMALITY = 0.3  # residual of the optimality conditions, which converged answers have near 0.01
ANGLE = 1.75e-3  # rad (0.1 degree), that the end may miss the goal's attitude


class Certificate(eqx.Module):
    """What the judge found. Violations are zero or positive, in each constraint's own unit; all is infinite that a
    flight which cannot be integrated says nothing of."""

    defect: Scalar
    """Largest distance between the planned and the re-flown state at a node, all states in one norm."""
    position_error: Scalar
    """m, of the re-flown end from the goal, in the components that are fixed."""
    velocity_error: Scalar
    """m/s, likewise."""
    attitude_error: Scalar
    """rad, likewise."""
    rate_error: Scalar
    """rad/s, likewise."""
    at_nodes: Float[Array, "constraints"]
    """Worst violation at the nodes, for each constraint in the order of ``names``."""
    between_nodes: Float[Array, "constraints"]
    """Worst violation over dense samples of the whole flight."""
    allowed: Float[Array, "constraints"]
    """Violation that counts as none: 1 mm for distances, 1e-3 of a limit or of the range between two."""
    optimality: Scalar | None
    """Residual of the nonlinear problem's optimality conditions (``stationarity``); None where a method claims none."""
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def violation(self) -> Scalar:
        """Worst violation of any constraint over the whole flight."""
        return jnp.max(self.between_nodes, axis=-1)

    def report(self) -> str:
        """A short text for people; for one solution, not a batch."""
        lines = [
            f"re-flown end: {1e3 * float(self.position_error):.3g} mm, "
            f"{float(jnp.degrees(self.attitude_error)):.3g} deg, {float(self.velocity_error):.3g} m/s, "
            f"{float(self.rate_error):.3g} rad/s from the goal",
            f"largest defect {float(self.defect):.3g}",
        ]
        if self.optimality is not None:
            lines.append(f"optimality conditions lack {float(self.optimality):.3g} of the cost")
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
    """Judge a rigid-body trajectory against its problem.

    Args:
        problem: what was asked.
        trajectory: the answer; only its controls, its dilation and its first state are trusted. ``problem.final``
            must be a condition on (position, velocity, attitude by 3 or 4 components, body rate).
        samples: points an interval at which constraints are evaluated, two at least.
        optimality: what ``stationarity`` found, if the method claims an optimum.
    """
    flight = fly(problem, trajectory, samples)
    missed = problem.final.function(flight.state[-1, -1], trajectory.time[-1], problem.final.parameters)
    defect = jnp.max(jnp.linalg.norm(flight.state[:, -1] - trajectory.state[1:], axis=-1))
    judged = [_judge(c, trajectory, flight) for c in problem.constraints]
    certificate = Certificate(
        defect=defect,
        position_error=jnp.linalg.norm(missed[:3]),
        velocity_error=jnp.linalg.norm(missed[3:6]),
        attitude_error=_angle(missed[6:-3]),
        rate_error=jnp.linalg.norm(missed[-3:]),
        at_nodes=jnp.stack([at_nodes for at_nodes, _ in judged]),
        between_nodes=jnp.stack([between for _, between in judged]),
        allowed=jnp.stack([jnp.asarray(c.allowed, float) for c in problem.constraints]),
        optimality=optimality,
        names=tuple(c.name for c in problem.constraints),
    )
    return jax.tree.map(lambda v: jnp.where(jnp.isnan(v), jnp.inf, v), certificate)


def _angle(missed: Float[Array, "_"]) -> Scalar:
    """Angle of a rotation from what a boundary condition says of it: the difference of two quaternions (4,), of
    length 2 sin(angle / 4), or a vector part (3,), of length sin(angle / 2)."""
    length = jnp.linalg.norm(missed)
    if missed.shape[0] == 4:
        return 4.0 * jnp.arcsin(jnp.minimum(0.5 * length, 1.0))
    return 2.0 * jnp.arcsin(jnp.minimum(length, 1.0))


def _nodes_only(trajectory: Trajectory) -> Flight:
    return Flight(trajectory.time[:, None], trajectory.state[:, None], trajectory.control[:, None])


def _flown_nodes(trajectory: Trajectory, flight: Flight) -> Flight:
    """The nodes as flown, not as planned."""
    state = jnp.concatenate([flight.state[:, :1], flight.state[-1:, -1:]])
    return Flight(trajectory.time[:, None], state, trajectory.control[:, None])


def _violation(constraint: Constraint, value) -> Scalar:
    if isinstance(constraint.cone, SecondOrder):
        return jnp.linalg.norm(value[1:]) - value[0]
    if isinstance(constraint.cone, NonNegative):
        return -jnp.min(value)
    return jnp.max(jnp.abs(value))


def _worst(constraint: Constraint, flight: Flight) -> Scalar:
    """Worst violation on a flight; interval k is judged by the parameters of node k."""
    count = flight.time.shape[0]

    def violation(state, control, time, parameters):
        return _violation(constraint, constraint.function(state, control, time, parameters))

    over_samples = jax.vmap(violation, in_axes=(0, 0, 0, None))
    parameters = jax.tree.map(lambda p: p[:count], constraint.parameters)
    values = jax.vmap(over_samples)(flight.state, flight.control, flight.time, parameters)
    active = constraint.active[:count]
    return jnp.max(jnp.where(active[:, None], values, 0.0), initial=0.0)


def _worst_across(constraint: Constraint, trajectory: Trajectory) -> Scalar:
    intervals = trajectory.time.shape[0] - 1
    held = jnp.concatenate([trajectory.control, trajectory.dilation[:, None]], axis=1)
    parameters = jax.tree.map(lambda p: p[:-1], constraint.parameters)

    def violation(first, last, parameters):
        return _violation(constraint, constraint.function(first, last, 1.0 / intervals, parameters))

    values = jax.vmap(violation)(held[:-1], held[1:], parameters)
    return jnp.max(jnp.where(constraint.active[:-1], values, 0.0), initial=0.0)


def _judge(constraint: Constraint, trajectory: Trajectory, flight: Flight) -> tuple[Scalar, Scalar]:
    """Worst violation at the nodes, and wherever the constraint is meant to hold."""
    if isinstance(constraint.where, AcrossIntervals):
        worst = _worst_across(constraint, trajectory)
        return worst, worst
    at_nodes = _worst(constraint, _nodes_only(trajectory))
    if isinstance(constraint.where, AtNodes):
        return at_nodes, _worst(constraint, _flown_nodes(trajectory, flight))
    return at_nodes, _worst(constraint, flight)


def acceptable(certificate: Certificate, between_nodes: bool = True) -> Flag:
    """Whether the re-flown end lies within 1 mm and 0.1 degree of the goal, no constraint is violated anywhere on
    the flight by more than 1 mm, or 1e-3 of a limit, and the point is stationary, if it claims to be.

    Args:
        certificate: what the judge found.
        between_nodes: whether the constraints are judged; the paper's method keeps them at the nodes only.
    """
    lands = (certificate.position_error <= DISTANCE) & (certificate.attitude_error <= ANGLE)
    if certificate.optimality is not None:
        lands &= certificate.optimality <= OPTIMALITY
    return lands & jnp.all(certificate.between_nodes <= certificate.allowed) if between_nodes else lands
