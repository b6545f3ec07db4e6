"""Prediction of the state under controls that are linear in time, with an offset of its derivative."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.integration import dispatch, tableaus
from jaxscp.integration.intervals import Intervals, without_data


class Plan(eqx.Module):
    """Nodes of a prediction: the shooting variables of multiple shooting."""

    time: Scalar
    """s, of the first node."""
    state: Float[Array, "nodes states"]
    control: Float[Array, "nodes controls"]
    """Linear between nodes."""

    def at(self, times: Float[Array, "times"], grid: Float[Array, "nodes"]) -> tuple[Array, Array]:
        """States and controls at times, linear between nodes, held after the last.

        Args:
            times: s.
            grid: of the nodes, s from the first.
        """
        elapsed = jnp.clip(times - self.time, 0.0, grid[-1])
        i = jnp.clip(
            jnp.searchsorted(grid, elapsed, side="right", method="compare_all") - 1, 0, grid.shape[0] - 2
        )
        fraction = ((elapsed - grid[i]) / (grid[i + 1] - grid[i]))[:, None]
        between = lambda v: v[i] + fraction * (v[i + 1] - v[i])  # noqa: E731
        return between(self.state), between(self.control)


class Linearisation(eqx.Module):
    """x_{k+1} = A_k x_k + B-_k u_k + B+_k u_{k+1} + defect_k, all as deviations from a plan."""

    state: Float[Array, "intervals states states"]
    """A"""
    first: Float[Array, "intervals states controls"]
    """B-"""
    last: Float[Array, "intervals states controls"]
    """B+"""
    defect: Float[Array, "intervals states"]
    """End of an interval's integration, less the plan's next node."""


class _Rate(eqx.Module):
    """Derivative over a fraction of an interval; controls are (u, length of the interval, time)."""

    dynamics: Dynamics
    offset: Float[Array, "states"]

    def __call__(self, state: Array, control: Array) -> Array:
        u, length, time = control[:-2], control[-2], control[-1]
        # the running cost, last, is zero
        return jnp.append(length * (self.dynamics(state, u, time) + self.offset), 0.0 * length)


def linearise(dynamics: Dynamics, offset: Float[Array, "states"], plan: Plan, grid: Array, steps: int):
    """Linearisation of all intervals about a plan, by one Runge-Kutta integration with its derivatives.

    Args:
        dynamics: equations of motion.
        offset: added to the state's derivative.
        plan: nodes.
        grid: of the nodes, s from the first.
        steps: Runge-Kutta steps of an interval.
    """
    w = _variables(plan.state[:-1], plan.control, plan.time + grid)
    intervals = _intervals(dynamics, offset, steps)
    value, jacobian = dispatch.linearise(intervals, w, without_data(intervals, w.shape[0]))
    n, m = dynamics.state_size, dynamics.control_size
    of = jacobian.end
    return Linearisation(
        of[..., :n], of[..., n : n + m], of[..., n + m + 2 : n + 2 * m + 2], value.end - plan.state[1:]
    )


def advance(dynamics: Dynamics, offset: Float[Array, "states"], state, controls, times) -> Float[Array, "n"]:
    """State after one interval, by one Runge-Kutta step.

    Args:
        dynamics: equations of motion.
        offset: added to the state's derivative.
        state: at the start.
        controls: (2, controls), at the start and at the end.
        times: (2,) s.
    """
    w = _variables(state[None], controls, times)
    intervals = _intervals(dynamics, offset, 1)
    return dispatch.evaluate(intervals, w, without_data(intervals, 1)).end[0]


def _intervals(dynamics: Dynamics, offset: Array, steps: int) -> Intervals:
    return Intervals(_Rate(dynamics, offset), dynamics.state_size, tableaus.CLASSICAL, steps, steps)


def _variables(states: Array, controls: Array, times: Array) -> Float[Array, "intervals inputs"]:
    """(state, u, length, time; u, length, time at the end) of every interval."""
    length = jnp.diff(times)[:, None]
    ends = [(controls[:-1], times[:-1]), (controls[1:], times[1:])]
    return jnp.concatenate([states, *(v for u, t in ends for v in (u, length, t[:, None]))], axis=1)


def sensitivities(linearisation: Linearisation) -> Float[Array, "intervals states columns"]:
    """States of the nodes after the first, as functions of the controls after the first: condensing.

    The first node's state and controls are given. Columns are (deviation without a change of the controls; derivative
    in the controls of all nodes, one after the other), zero for later controls.
    """
    count, _, controls = linearisation.first.shape
    parts = linearisation.state, linearisation.first, linearisation.last, linearisation.defect
    columns = jnp.concatenate([linearisation.defect[0][:, None], linearisation.last[0]], axis=1)
    found = [columns]
    # not a scan: later nodes depend on more controls, and small products without a loop take half the time
    for a, first, last, defect in zip(*(part[1:] for part in parts), strict=True):
        moved = a @ columns
        deviation, recent = moved[:, :1] + defect[:, None], moved[:, -controls:] + first
        columns = jnp.concatenate([deviation, moved[:, 1:-controls], recent, last], axis=1)
        found.append(columns)
    width = 1 + count * controls
    return jnp.stack([jnp.pad(c, ((0, 0), (0, width - c.shape[1]))) for c in found])
