"""Explicit Runge-Kutta methods of fixed step, as their tables."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


@dataclass(frozen=True, eq=False)
class Method:
    """A method's table (Butcher)."""

    shares: np.ndarray
    """(stages,), of the step at which slopes are taken."""
    weights: np.ndarray
    """(stages,), of the slopes in the step."""
    table: np.ndarray
    """(stages, stages): a row has the weights of the slopes that lead to its stage."""

    @property
    def stages(self) -> int:
        """Slopes of a step."""
        return len(self.shares)


CLASSICAL = Method(
    np.array([0, 1 / 2, 1 / 2, 1]),
    np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    np.array([[0, 0, 0, 0], [1 / 2, 0, 0, 0], [0, 1 / 2, 0, 0], [0, 0, 1, 0]]),
)
"""Fourth order in four stages."""

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
"""Butcher, "On Runge-Kutta processes of high order" (1964): sixth order in seven stages. Ten steps of fourth order
evaluate more than five of these, and err more."""


def integrate(
    method: Method,
    rate: Callable[..., Array],
    state: Float[Array, "states"],
    steps: int,
    push: Float[Array, "steps stages states"] | None = None,
) -> Float[Array, "steps states"]:
    """The states after each of so many steps through a unit of the independent variable; see ``step``."""
    size = 1.0 / steps

    def forward(state, at):
        state, _ = step(method, rate, at[0], state, size, at[1])
        return state, state

    begins = size * jnp.arange(steps, dtype=state.dtype)
    return jax.lax.scan(forward, state, (begins, push))[1]


def step(
    method: Method,
    rate: Callable[..., Array],
    share: Array,
    state: Float[Array, "states"],
    size: float,
    push: Float[Array, "stages states"] | None = None,
) -> tuple[Float[Array, "states"], Float[Array, "stages states"]]:
    """One step.

    The stages are a loop, so that derivatives of the dynamics are traced and compiled once.

    Args:
        method: by which.
        rate: (share, state) -> slope.
        share: where the step begins.
        state: there.
        size: of the step.
        push: added to the slopes; of use for derivatives.

    Returns:
        The state after the step, and the states that the slopes are taken at.
    """

    def stage(slopes, at):
        index, node, row, push = at
        moved = state + size * jnp.sum(row[:, None] * slopes, axis=0)
        slope = rate(share + size * node, moved)
        slope = slope if push is None else slope + push
        return jax.lax.dynamic_update_index_in_dim(slopes, slope, index, 0), moved

    shares, weights, rows = (
        jnp.asarray(t, state.dtype) for t in (method.shares, method.weights, method.table)
    )
    begin = jnp.zeros((method.stages, state.shape[0]), state.dtype)
    slopes, moved = jax.lax.scan(stage, begin, (jnp.arange(method.stages), shares, rows, push))
    return state + size * jnp.sum(weights[:, None] * slopes, axis=0), moved
