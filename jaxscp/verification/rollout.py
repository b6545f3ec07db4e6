"""Rollout: the planned controls integrated again from the first state, without correction, sampled densely."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification.integrator.integrate import integrate


class Rollout(eqx.Module):
    """States and controls in every interval, from its first to its last point."""

    time: Float[Array, "intervals samples"]
    """s"""
    state: Float[Array, "intervals samples states"]
    control: Float[Array, "intervals samples controls"]


def rollout(problem: OptimalControlProblem, trajectory: Trajectory, samples: int) -> Rollout:
    """Rollout of a trajectory's controls from its first state.

    Args:
        problem: gives the dynamics.
        trajectory: gives the first state, the controls and the dilation.
        samples: points an interval, two at least.
    """
    intervals = trajectory.time.shape[0] - 1
    width, fractions = 1.0 / intervals, jnp.linspace(0.0, 1.0, samples)
    states = integrate(problem.dynamics, trajectory, samples)
    blend = fractions[None, :, None]
    control = (1.0 - blend) * trajectory.control[:-1, None] + blend * trajectory.control[1:, None]
    s0, s1 = trajectory.dilation[:-1, None], trajectory.dilation[1:, None]
    time = trajectory.time[:-1, None] + width * (s0 * fractions + 0.5 * (s1 - s0) * fractions**2)
    return Rollout(time, states, control)
