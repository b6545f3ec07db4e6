"""Cuts off the flown part of a plan, of its scenario and of its context."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from jaxscp.backends.xla import is_traced
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.types import Scalar
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.scenario import Advisor, Scenario


def checked_seconds(plan: Trajectory, elapsed: Any) -> float:
    """A known time since a plan's start, checked."""
    try:
        seconds = float("nan") if isinstance(elapsed, str | bool) else float(elapsed)
    except (TypeError, ValueError):
        seconds = float("nan")
    if not 0.0 <= seconds < float("inf"):
        raise InvalidScenario(f"elapsed: expected seconds since the old plan's start, got {elapsed!r}.")
    if not isinstance(plan.time, Tracer) and seconds > (end := float(np.asarray(plan.time)[-1])):
        raise InvalidScenario(
            f"elapsed: the old plan ended after {end:.4g} s, before elapsed = {seconds:.4g} s. "
            "Plan anew from the present state: planner(scenario)."
        )
    return seconds


@jax.jit
def rest_of(plan: Trajectory, context: Any, scenario: Any, elapsed: Scalar | float):
    """The rest of a plan, of its scenario and of its context after a time; NaN for a time outside of the plan."""
    elapsed = jnp.where((elapsed >= 0.0) & (elapsed <= plan.time[-1]), elapsed, jnp.nan)
    rest = plan.after(elapsed)
    if context is not None:
        first, count = plan.scaled_time(elapsed), plan.nodes - 1
        interval_of = lambda tau: jnp.minimum(jnp.floor(tau * count), count - 1).astype(int)  # noqa: E731
        scenario, context = scenario.without_passed(context, interval_of(first), rest.time[-1])
        # Old intervals in which the new ones lie: those are shorter, so that none of the old ones is left out. The
        # first one holds the start.
        middles = first + (1.0 - first) * (jnp.arange(count, dtype=first.dtype) + 0.5) / count
        middles = middles.at[0].set(first)
        context = jax.tree.map(lambda v: v[interval_of(middles)], context)
    return rest, scenario, context


def replan_doubt(plan: Trajectory, scenario: Scenario, seconds: Any) -> str | None:
    """The scenario's doubt about itself as the present one; None of a traced one."""
    if is_traced((plan, scenario, seconds)) or not isinstance(scenario, Advisor):
        return None
    return scenario.replan_doubt(plan, seconds) or None
