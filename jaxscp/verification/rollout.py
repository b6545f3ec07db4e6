"""The planned controls integrated again from the first state, sampled densely."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.verification import integrator


class Flight(eqx.Module):
    """The re-integrated flight, sampled in every interval from its first to its last point."""

    time: Float[Array, "intervals samples"]
    """s"""
    state: Float[Array, "intervals samples states"]
    control: Float[Array, "intervals samples controls"]


def fly(problem: OptimalControlProblem, trajectory: Trajectory, samples: int) -> Flight:
    """Integrate the planned controls from the first state, interval after interval."""
    intervals = trajectory.time.shape[0] - 1
    width, shares = 1.0 / intervals, jnp.linspace(0.0, 1.0, samples)
    states = integrator.states(problem.dynamics, trajectory, samples)
    blend = shares[None, :, None]
    control = (1.0 - blend) * trajectory.control[:-1, None] + blend * trajectory.control[1:, None]
    s0, s1 = trajectory.dilation[:-1, None], trajectory.dilation[1:, None]
    time = trajectory.time[:-1, None] + width * (s0 * shares + 0.5 * (s1 - s0) * shares**2)
    return Flight(time, states, control)
