"""Explicit Runge-Kutta methods of fixed step, given by their Butcher tableaus."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


@dataclass(frozen=True, eq=False)
class Method:
    """Butcher tableau of an explicit method, with s stages.

    With step size h, the slopes are k_i = f(t + c_i h, x + h sum_j a_ij k_j). The step ends at x + h sum_i b_i k_i.
    """

    c: np.ndarray
    """(stages,): nodes, as fractions of the step."""
    b: np.ndarray
    """(stages,): weights of the slopes k in the step."""
    a: np.ndarray
    """(stages, stages): row i holds the weights of the slopes that lead to stage i."""

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.c)


CLASSICAL = Method(
    np.array([0, 1 / 2, 1 / 2, 1]),
    np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    np.array([[0, 0, 0, 0], [1 / 2, 0, 0, 0], [0, 1 / 2, 0, 0], [0, 0, 1, 0]]),
)
"""RK4: fourth order in four stages."""

SIXTH_ORDER = Method(
    np.array([0, 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2, 1]),
    np.array([11 / 120, 0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120]),
    np.array(
        [
            [0, 0, 0, 0, 0, 0, 0],
            [1 / 3, 0, 0, 0, 0, 0, 0],
            [0, 2 / 3, 0, 0, 0, 0, 0],
            [1 / 12, 1 / 3, -1 / 12, 0, 0, 0, 0],
            [-1 / 16, 9 / 8, -3 / 16, -3 / 8, 0, 0, 0],
            [0, 9 / 8, -3 / 8, -3 / 4, 1 / 2, 0, 0],
            [9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11, 0],
        ]
    ),
)
"""Sixth order in seven stages (Butcher, "On Runge-Kutta processes of high order", 1964). Ten steps of fourth order
cost more evaluations than five of these, and have a larger error."""


def integrate(
    method: Method,
    rate: Callable[..., Array],
    state: Float[Array, "states"],
    steps: int,
    perturbation: Float[Array, "steps stages states"] | None = None,
) -> Float[Array, "steps states"]:
    """States after each of so many equal steps over a unit of the independent variable.

    Args:
        method: Butcher tableau.
        rate: right-hand side f(t, x), t from 0 to 1.
        state: initial state.
        steps: number of steps.
        perturbation: added to the slopes k; of use for derivatives.
    """
    size = 1.0 / steps

    def forward(state, at):
        state, _ = step(method, rate, at[0], state, size, at[1])
        return state, state

    begins = size * jnp.arange(steps, dtype=state.dtype)
    return jax.lax.scan(forward, state, (begins, perturbation))[1]


def step(
    method: Method,
    rate: Callable[..., Array],
    begin: Array,
    state: Float[Array, "states"],
    size: float,
    perturbation: Float[Array, "stages states"] | None = None,
) -> tuple[Float[Array, "states"], Float[Array, "stages states"]]:
    """State after one step, and the states at its stages.

    The stages are a loop, so that derivatives of the rate are traced and compiled once.

    Args:
        method: Butcher tableau.
        rate: right-hand side f(t, x).
        begin: t at the step's begin.
        state: x at the step's begin.
        size: step size h.
        perturbation: added to the slopes k; of use for derivatives.
    """

    def stage(slopes, at):
        index, c, row, perturbation = at
        stage_state = state + size * jnp.sum(row[:, None] * slopes, axis=0)
        slope = rate(begin + size * c, stage_state)
        slope = slope if perturbation is None else slope + perturbation
        return jax.lax.dynamic_update_index_in_dim(slopes, slope, index, 0), stage_state

    c, b, a = (jnp.asarray(t, state.dtype) for t in (method.c, method.b, method.a))
    zeros = jnp.zeros((method.stages, state.shape[0]), state.dtype)
    slopes, stage_states = jax.lax.scan(stage, zeros, (jnp.arange(method.stages), c, a, perturbation))
    return state + size * jnp.sum(b[:, None] * slopes, axis=0), stage_states
