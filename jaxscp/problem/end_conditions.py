"""The conditions at both ends of a problem over scaled time, and their linearisation."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.problem.scaled_time import ScaledTimeProblem


class Condition(eqx.Module):
    """Conditions at one end of the trajectory, to first order about its state."""

    jacobian: Float[Array, "conditions states"]
    value: Float[Array, "conditions"]
    """Zero where they hold."""


def start_condition(problem: ScaledTimeProblem, state: Float[Array, "states"]) -> Float[Array, "conditions"]:
    """Value of the conditions at the start, where time and running cost are zero, and the copy is the state itself."""
    x, time = problem.split_state(state)
    value = problem.boundary.initial.value(x, time)
    value = value if problem.sizes is None else value / problem.sizes.initial
    n, dynamic = problem.dynamics.state_size, problem.dynamic_states
    copied = [] if problem.boundary.coupled is None else [state[n:dynamic] - state[:n]]
    return jnp.concatenate([value, *copied, state[dynamic:]])


def end_condition(problem: ScaledTimeProblem, state: Float[Array, "states"]) -> Float[Array, "conditions"]:
    """Value of the conditions at the end, and of those on both ends."""
    x, time = problem.split_state(state)
    value, sizes = problem.boundary.final.value(x, time), problem.sizes
    value = value if sizes is None else value / sizes.final
    coupled, n = problem.boundary.coupled, problem.dynamics.state_size
    if coupled is None:
        return value
    first, _ = problem.split_state(jnp.concatenate([state[n : 2 * n], state[n:]]))
    both = coupled.value(first, x, time)
    both = both if sizes is None or sizes.coupled is None else both / sizes.coupled
    return jnp.concatenate([value, both])


def end_residuals(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]
) -> tuple[Float[Array, "initial"], Float[Array, "final"]]:
    """Values of the conditions at the start and at the end; zero where they hold."""
    n = problem.state_size
    return start_condition(problem, z[0, :n]), end_condition(problem, z[-1, :n])


def linearised_ends(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]
) -> tuple[Condition, Condition]:
    """The conditions at the start and at the end."""
    n = problem.state_size

    def one(condition, state):
        value = functools.partial(condition, problem)
        return Condition(jax.jacfwd(value)(state), value(state))

    return one(start_condition, z[0, :n]), one(end_condition, z[-1, :n])
