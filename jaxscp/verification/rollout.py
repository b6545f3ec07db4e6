"""Rollout: the planned controls integrated again from the first state, without correction, sampled densely."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.program import reads
from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.problem.canonical import canonical
from jaxscp.problem.form import Continuous
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.integrator.integrate import integrate


class _WithClock(Dynamics):
    """Dynamics that may read the time, with the time as their last state."""

    inner: Dynamics

    @property
    def state_size(self) -> int:
        """Inner states, and the time."""
        return self.inner.state_size + 1

    @property
    def control_size(self) -> int:
        """Of the inner dynamics."""
        return self.inner.control_size

    def __call__(
        self, state: Float[Array, "states"], control: Float[Array, "controls"], time: Scalar | float = 0.0
    ) -> Float[Array, "states"]:
        """Time grows by one second each second."""
        return jnp.append(self.inner(state[:-1], control, state[-1]), 1.0)


def _with_clock(trajectory: Trajectory) -> Trajectory:
    state = jnp.concatenate([trajectory.state, trajectory.time[:, None]], axis=1)
    return eqx.tree_at(lambda t: t.state, trajectory, state)


class Rollout(eqx.Module):
    """States and controls in every interval, from its first to its last point."""

    time: Float[Array, "intervals samples"]
    """s"""
    state: Float[Array, "intervals samples states"]
    control: Float[Array, "intervals samples controls"]


def rollout(
    problem: OptimalControlProblem | ScaledTimeProblem, trajectory: Trajectory, samples: int
) -> Rollout:
    """Rollout of a trajectory's controls from its first state.

    Args:
        problem: gives the dynamics.
        trajectory: gives the first state, the controls and the dilation.
        samples: points an interval, two at least.
    """
    if isinstance(problem, OptimalControlProblem):
        problem = over_scaled_time(canonical(problem), Continuous(), trajectory)
    intervals = trajectory.time.shape[0] - 1
    width, fractions = 1.0 / intervals, jnp.linspace(0.0, 1.0, samples)
    at = trajectory.state[0], trajectory.control[0], 0.0
    if reads(problem.dynamics, 2, *at):
        states = integrate(_WithClock(problem.dynamics), _with_clock(trajectory), samples)[:, :, :-1]
    else:
        states = integrate(problem.dynamics, trajectory, samples)
    blend = fractions[None, :, None]
    first, last = trajectory.interval_controls()
    control = (1.0 - blend) * first[:, None] + blend * last[:, None]
    s0, s1 = trajectory.dilation[:-1, None], trajectory.dilation[1:, None]
    time = trajectory.time[:-1, None] + width * (s0 * fractions + 0.5 * (s1 - s0) * fractions**2)
    return Rollout(time, states, control)
