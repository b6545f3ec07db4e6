"""Receding horizon: a planner called at a fixed rate, with a deadline.

The loop always holds the newest plan that passed verification. Plans start where the held plan will be at the deadline,
so that the vehicle is there when the new plan begins.
"""

import time as clock
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.status import Status, StatusCode, status_names
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.trajectory import Trajectory


class HeldPlan(eqx.Module):
    """A plan that passed verification, and the time at which it begins."""

    trajectory: Trajectory
    start: Scalar
    """s, of the loop's clock: the plan's time zero."""
    requested: Scalar
    """s, of the request: the plan knows no later data."""

    def age(self, time: Scalar | float) -> Scalar:
        """Seconds since the request."""
        return time - self.requested

    @eqx.filter_jit
    def remaining(self, time: Scalar | float) -> Trajectory:
        """The part of the plan from a time on, on as many nodes: the guess of a re-plan.

        See ``Trajectory.after``. Before the start it is the whole plan.
        """
        return self.trajectory.after(time - self.start).with_dynamics(self.trajectory.dynamics)

    def state_at(self, time: Scalar | float) -> Float[Array, "states"]:
        """State that the plan has at a time, held at its ends; where a new plan may begin.

        Raises:
            ValueError: if the trajectory has no dynamics.
        """
        elapsed = jnp.clip(time - self.start, 0.0, self.trajectory.time[-1])
        return self.trajectory.at(elapsed).state


def replaced(held: HeldPlan, new: HeldPlan, status: StatusCode) -> tuple[HeldPlan, Flag]:
    """The new plan if it converged, which includes verification; else the held one; and whether it was replaced.

    Both have the same shapes. It is pure: for simulations in ``jit`` and ``vmap``.
    """
    accepted = status == Status.converged
    return tree_where(accepted, new, held), accepted


class RecedingHorizon:
    """Calls a planner every period, and holds the newest plan that passed verification. It lives on the host.

    Call ``update`` at every tick of the vehicle. It never waits, if an executor is given.

    Args:
        replan: (solution or trajectory, scenario) -> solution; ``planner.replan``.
        solution: the first plan, converged.
        period: s between two requests.
        deadline: s that a plan may take. A later one is dropped.
        executor: runs the planner, ``concurrent.futures.ThreadPoolExecutor(1)``; None plans within ``update``.
        timer: clock in s that measures the planner.

    Raises:
        ValueError: if the first plan has not converged, or the period is shorter than the deadline.

    Example:
        >>> import types, jaxscp
        >>> from jaxscp.control import RecedingHorizon
        >>> line = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 1.0], [2.0, 1.0]], [[0.0], [0.0]])
        >>> line = line.with_dynamics(jaxscp.DoubleIntegrator(1))
        >>> plan = types.SimpleNamespace(trajectory=line, status=jaxscp.Status.converged)
        >>> horizon = RecedingHorizon(lambda guess, goal: plan, plan, period=0.5, deadline=0.1)
        >>> held = horizon.update(0.6, lambda state: "a scenario that starts at this state")
        >>> float(horizon.update(0.8, None).start), horizon.outcome
        (0.7, 'converged')
    """

    def __init__(
        self,
        replan: Callable[[Any, Any], Any],
        solution: Any,
        period: float,
        deadline: float,
        executor: Executor | None = None,
        timer: Callable[[], float] = clock.perf_counter,
    ) -> None:
        if status_names(solution.status) != "converged":
            raise ValueError(f"solution: a converged plan is needed, got {status_names(solution.status)}")
        if not 0.0 < deadline <= period:
            raise ValueError(
                f"deadline: expected a time above zero, up to the period of {period} s, got {deadline} s"
            )
        self._replan, self._executor, self._timer = replan, executor or _Inline(), timer
        self.period, self.deadline = period, deadline
        self.held = HeldPlan(solution.trajectory, jnp.zeros(()), jnp.zeros(()))
        self.outcome = "converged"
        """Of the last request: the status of its plan, ``late``, or ``failed`` where the planner raised an error."""
        self.error: Exception | None = None
        """The error of a planner that failed."""
        self._next: HeldPlan | None = None
        self._running: tuple[Future, float] | None = None
        self._due = period

    def age(self, time: float) -> float:
        """Seconds since the request of the held plan."""
        return float(self.held.age(time))

    def update(self, time: float, scenario: Callable[[Array], Any] | None) -> HeldPlan:
        """The plan to follow at a time.

        Args:
            time: s, from the start of the first plan.
            scenario: (state) -> scenario that starts at the state, with the goal and the corridor as they are known
                now; called if a request is due. None asks for no plan.
        """
        self._collect(time)
        if self._next is not None and time >= float(self._next.start):
            self.held, self._next = self._next, None
        if scenario is not None and time >= self._due and self._running is None and self._next is None:
            begin = time + self.deadline
            guess, asked = self.held.remaining(begin), scenario(self.held.state_at(begin))
            self._running = self._executor.submit(self._timed, guess, asked), time
            self._due = time + self.period
            self._collect(time)
        return self.held

    def _timed(self, guess: Trajectory, scenario: Any) -> tuple[Any, float]:
        """The planner's solution, and the seconds that it took."""
        began = self._timer()
        solution = jax.block_until_ready(self._replan(guess, scenario))
        return solution, self._timer() - began

    def _collect(self, time: float) -> None:
        """Take the solution of a request that has ended."""
        if self._running is None or not self._running[0].done():
            return
        (future, requested), self._running = self._running, None
        try:
            solution, seconds = future.result()
        except Exception as error:  # a planner may refuse a scenario: the held plan stays
            self.outcome, self.error = "failed", error
            return
        late = seconds > self.deadline or time > requested + self.deadline
        self.outcome = "late" if late else str(status_names(solution.status))
        if self.outcome == "converged":
            start = jnp.asarray(requested + self.deadline)
            self._next = HeldPlan(solution.trajectory, start, jnp.asarray(requested))


class _Inline(Executor):
    """Runs a call at once, in the caller's thread."""

    def submit(self, fn, /, *args, **kwargs) -> Future:
        """A future that is done."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
