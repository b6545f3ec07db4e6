"""Nonlinear model predictive control by the real-time iteration.

Each tick linearises the horizon about the shifted plan of the last tick, and solves one convex program. This is one
Gauss-Newton step of the tracking problem (Diehl, Bock and Schloeder, "A real-time iteration scheme for nonlinear
optimization in optimal feedback control", 2005; Gros, Zanon, Quirynen, Bemporad and Diehl, "From linear to nonlinear
MPC: bridging the gap via the real-time iteration", 2020).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.control import bounded_qp, disturbance, subproblem
from jaxscp.control.actuators import Actuators
from jaxscp.control.disturbance import DisturbanceModel, Observed
from jaxscp.control.horizon import Horizon
from jaxscp.control.prediction import Plan, advance, linearise, sensitivities
from jaxscp.control.reference import SAMPLES, Reference
from jaxscp.control.tracking import Tracking
from jaxscp.core.errors import InvalidProblem
from jaxscp.core.status import Status, StatusCode
from jaxscp.core.types import Flag, Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.trajectory import Trajectory

END = 0.01  # of the tolerance: there the interior point ends


class NMPCState(eqx.Module):
    """Memory of the controller."""

    plan: Plan
    """Prediction of the last tick."""
    active: Float[Array, "controls"]
    """Controls that act now, by the model of the actuators."""
    commands: Float[Array, "delay controls"]
    """Commands on their way, oldest first."""
    before: Float[Array, "controls"]
    """Controls that acted a tick ago."""
    estimate: Float[Array, "states"]
    """Of the last tick."""
    observed: Observed
    status: StatusCode
    """Of the last tick: ``converged``, ``iteration_limit`` (the step keeps all limits, but is not exact), or
    ``numerical_error`` (an estimate, a reference or a step was not finite: the command is of the shifted plan)."""

    @property
    def disturbance(self) -> Float[Array, "disturbances"]:
        """Estimate of the disturbance; of a rigid body, force in the world in N and torque in body axes in N m."""
        return self.observed.disturbance


class NMPC(eqx.Module):
    """Tracks a reference within limits of the controls, under slowly changing disturbances.

    A pure function (reference, state, estimate, time) -> (state, command): it jits, vmaps, scans and differentiates.

    Args:
        dynamics: any ``Dynamics``; of a vehicle, ``airframe.body``.
        actuators: limits, lag and delay of the controls.
        tracking: weights; ``Tracking.of(dynamics)`` by default.
        disturbances: ``DisturbanceModel.of(dynamics)`` by default.
        horizon: grid, tick and work.

    Raises:
        InvalidProblem: if the sizes of the parts disagree; the message names the field.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> from jaxscp.control import NMPC, Actuators
        >>> nmpc = NMPC(jaxscp.DoubleIntegrator(1), Actuators([-2.0], [2.0]))
        >>> target = nmpc.hold(jnp.zeros(2), jnp.zeros(1))
        >>> away = jnp.array([1.0, 0.0])
        >>> state, command = nmpc(target, nmpc.init(target, away), away, 0.0)
        >>> bool(command[0] < 0.0), jaxscp.status_names(state.status)
        (True, 'converged')
    """

    dynamics: Dynamics
    actuators: Actuators
    tracking: Tracking
    disturbances: DisturbanceModel
    horizon: Horizon

    def __init__(
        self,
        dynamics: Dynamics,
        actuators: Actuators,
        tracking: Tracking | None = None,
        disturbances: DisturbanceModel | None = None,
        horizon: Horizon | None = None,
    ):
        self.dynamics, self.actuators = dynamics, actuators
        self.tracking = Tracking.of(dynamics) if tracking is None else tracking
        self.disturbances = DisturbanceModel.of(dynamics) if disturbances is None else disturbances
        self.horizon = Horizon() if horizon is None else horizon
        self._check()

    def _check(self) -> None:
        """Raise an error that names the field, if sizes disagree."""
        n, m = self.dynamics.state_size, self.dynamics.control_size
        rows = self.disturbances.effect.shape[0]
        sizes = (
            ("actuators.lower", self.actuators.lower.shape, (m,), "controls of the dynamics"),
            ("tracking.control", self.tracking.control.shape, (m,), "controls of the dynamics"),
            ("tracking.control_rate", self.tracking.control_rate.shape, (m,), "controls of the dynamics"),
            (
                "tracking.final",
                self.tracking.final.shape,
                self.tracking.state.shape,
                "weights in tracking.state",
            ),
            ("disturbances.effect", (rows,), (n,), "rows, the states of the dynamics"),
        )
        for field, found, expected, meaning in sizes:
            if found != expected:
                raise InvalidProblem(f"{field}: expected {expected[0]} {meaning}, got shape {found}")

    def follow(
        self, trajectory: Trajectory, start: Scalar | float = 0.0, final_control=None, samples: int = SAMPLES
    ) -> Reference:
        """The reference of a plan, see ``Reference.of``. To make one takes longer than a tick."""
        return self._with_compensation(Reference.of(trajectory, start, final_control, samples))

    def hold(self, state, control) -> Reference:
        """The reference of a state at rest, see ``Reference.hold``."""
        return self._with_compensation(Reference.hold(state, control))

    def init(self, reference: Reference, estimate, time: Scalar | float = 0.0, active=None) -> NMPCState:
        """The controller's memory before its first tick.

        Args:
            reference: to follow.
            estimate: (states,) now.
            time: s, of the first tick.
            active: (controls,) that act now, within their bounds; the reference's controls by default.
        """
        begin = jnp.asarray(time, dtype=reference.state.dtype)
        return self._init(reference, jnp.asarray(estimate), begin, active)

    @eqx.filter_jit
    def _init(self, reference: Reference, estimate: Array, begin: Scalar, active: Array | None) -> NMPCState:
        state, control = reference.at(begin + self.horizon.grid)
        active = control[0] if active is None else active
        active = jnp.clip(active, self.actuators.lower, self.actuators.upper)
        commands = jnp.tile(active, (self.actuators.delay, 1))
        disturbances = self.disturbances.effect.shape[1]
        observed = Observed(self.disturbances.observed @ estimate, jnp.zeros(disturbances))
        plan = Plan(begin, state, control.at[0].set(active))
        return NMPCState(plan, active, commands, active, estimate, observed, Status.converged)

    def __call__(
        self, reference: Reference, state: NMPCState, estimate: Float[Array, "states"], time: Scalar | float
    ) -> tuple[NMPCState, Float[Array, "controls"]]:
        """One tick.

        Args:
            reference: of ``follow`` or ``hold``.
            state: of ``init`` or of the last tick.
            estimate: (states,) of the vehicle, now.
            time: s; calls come every ``horizon.tick``.

        Returns:
            The controller's memory, and the (controls,) command, within its bounds.
        """
        # a Python number would be a constant of the program, which then compiled for each tick
        return self._tick(reference, state, estimate, jnp.asarray(time, dtype=estimate.dtype))

    @eqx.filter_jit
    def _tick(self, reference: Reference, state: NMPCState, estimate: Array, time: Scalar):
        told = jnp.isfinite(time)
        time = jnp.where(told, time, state.plan.time + (1 - self.actuators.delay) * self.horizon.tick)
        estimate, observed, seen = self._observe(state, estimate, time)
        begin, active = self._after_delay(state, observed.disturbance, estimate, time)
        guess = self._shifted(state.plan, begin, active, time)
        plan, status = self._improved(reference, guess, observed.disturbance)
        status = Status.where(seen & told, status, Status.numerical_error)
        tick, actuators = self.horizon.tick, self.actuators
        target = active + tick / self.horizon.intervals[0] * (plan.control[1] - active)
        command = actuators.command(active, target, tick)
        commands = jnp.concatenate([state.commands, command[None]])
        later = actuators.advance(state.active, commands[0], tick)
        return NMPCState(plan, later, commands[1:], state.active, estimate, observed, status), command

    def _observe(self, state: NMPCState, estimate: Array, time: Scalar) -> tuple[Array, Observed, Flag]:
        """State and disturbance of now, as expected where the estimate is not finite, and whether it is."""
        tick = self.horizon.tick
        offset = self.disturbances.effect @ state.disturbance
        controls, times = jnp.stack([state.before, state.active]), jnp.stack([time - tick, time])
        expected = advance(self.dynamics, offset, state.estimate, controls, times)
        seen = jnp.all(jnp.isfinite(estimate))
        estimate = jnp.where(seen, estimate, expected)
        change = expected - state.estimate
        observed = disturbance.update(self.disturbances, tick, state.observed, change, estimate)
        return estimate, observed, seen

    def _after_delay(self, state: NMPCState, disturbed: Array, estimate: Array, time: Scalar):
        """State and active controls when the next command begins to act."""
        offset, tick = self.disturbances.effect @ disturbed, self.horizon.tick
        active = state.active
        for number in range(self.actuators.delay):
            later = self.actuators.advance(active, state.commands[number], tick)
            times = time + tick * jnp.array([number, number + 1.0], dtype=time.dtype)
            estimate = advance(self.dynamics, offset, estimate, jnp.stack([active, later]), times)
            active = later
        return estimate, active

    def _shifted(self, plan: Plan, state: Array, active: Array, time: Scalar) -> Plan:
        """The plan of the last tick, from the given state on."""
        start = time + self.actuators.delay * self.horizon.tick
        states, controls = plan.at(start + self.horizon.grid, self.horizon.grid)
        return Plan(start, states.at[0].set(state), controls.at[0].set(active))

    def _improved(self, reference: Reference, guess: Plan, disturbed: Array) -> tuple[Plan, StatusCode]:
        """The plan after one convex step; the guess itself if that step is not finite."""
        horizon = self.horizon
        offset, target = self._target(reference, guess, disturbed)
        linear = linearise(self.dynamics, offset, guess, horizon.grid, horizon.steps)
        found = sensitivities(linear)
        qp = subproblem.tracking_qp(self.tracking, self.actuators, guess, target, found, horizon.grid)
        centre = subproblem.centre(self.actuators, guess.control[0], horizon.grid)
        end = END * horizon.tolerance
        solution = bounded_qp.solve(qp, guess.control[1:], centre, horizon.iterations, end)
        change = (solution.v - guess.control[1:]).ravel()
        moved = found[..., 1:].reshape(-1, change.shape[0]) @ change
        states = guess.state[1:] + found[..., 0] + moved.reshape(found.shape[:2])
        # the residual is not finite if the program was not
        finite = jnp.all(jnp.isfinite(states)) & jnp.isfinite(solution.residual)
        keep = lambda new, old: old.at[1:].set(jnp.where(finite, new, old[1:]))  # noqa: E731
        plan = Plan(guess.time, keep(states, guess.state), keep(solution.v, guess.control))
        exact = jnp.maximum(solution.residual, solution.complementarity) <= horizon.tolerance
        status = Status.where(exact, Status.converged, Status.iteration_limit)
        return plan, Status.where(finite, status, Status.numerical_error)

    def _target(self, reference: Reference, guess: Plan, disturbed: Array):
        """Offset of the state's derivative, and the reference under the disturbance."""
        times = guess.time + self.horizon.grid
        return self.disturbances.effect @ disturbed, reference.compensated(times, disturbed)

    @eqx.filter_jit
    def _with_compensation(self, reference: Reference) -> Reference:
        """The reference, with its compensation of disturbances at every sample."""
        times = reference.start + reference.step * jnp.arange(
            reference.state.shape[0], dtype=reference.step.dtype
        )

        def one(state, control, time):
            model = self.dynamics, self.disturbances, self.tracking
            return disturbance.compensation(*model, state, control, time)

        found = jax.vmap(one)(reference.state, reference.control, times)
        return eqx.tree_at(lambda r: r.compensation, reference, found)
