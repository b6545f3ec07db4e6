"""The mesh of a result: whether its intervals are short enough to integrate, and bounds on those that are not.

A free mesh may leave one interval so long that the integration, of fixed steps, gains from its own errors there. Twice
the steps tell the error. As in mesh refinement (Betts, Practical Methods for Optimal Control, 2010, section 4.7), the
order of the method tells how short the interval must be.

What counts is the error of the flight, which the certificate measures: the errors of the intervals, each carried along
by the dynamics. Bounds cost freedom. So there are none while the flight is accurate, however long one interval is.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Nodes, Scalar
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.shooting import Grid, evaluate, linearise

# Of the flight at every node, in typical sizes: on a route of 20 m, the millimetre that the certificate allows at its
# end. Measured, the position has at most two fifths of the error, so that it keeps to the millimetre on up to 50 m.
ACCURACY = 5e-5
ORDER = 7  # of an interval's error in its length
RESERVE = 0.9  # of the length that the order tells
SHORTEST = 0.3  # times its length, that an interval is bounded to at once


def bounds(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Nodes:
    """Greatest dilation of each node that keeps the flight accurate; infinite where an interval hardly matters."""
    sizes, finer = typical_sizes(z)[: problem.state_size], dataclasses.replace(grid, steps=2 * grid.steps)
    linear = linearise(problem, z, grid)
    errors = linear.outputs.end - evaluate(problem, z, finer).end
    parts = carried_along(linear.jacobian.end[:, :, : problem.state_size], errors) / sizes
    coarse = ~jnp.all(jnp.linalg.norm(jnp.sum(parts, axis=1), axis=1) <= ACCURACY)
    worst = jnp.nan_to_num(jnp.max(jnp.linalg.norm(parts, axis=2), axis=0), nan=jnp.inf, posinf=jnp.inf)
    excess = worst / _level(worst)
    lengths = jnp.maximum(z[:-1, -1], z[1:, -1])
    shorter = lengths * jnp.maximum(RESERVE * jnp.maximum(excess, 1.0) ** (-1.0 / ORDER), SHORTEST)
    interval = jnp.where(coarse & (excess > 1.0), shorter, jnp.inf)
    none = jnp.full((1,), jnp.inf)
    return jnp.minimum(jnp.concatenate([interval, none]), jnp.concatenate([none, interval]))


def carried_along(
    transition: Float[Array, "intervals states states"], errors: Float[Array, "intervals states"]
) -> Float[Array, "intervals intervals states"]:
    """Part of the flight's error at the end of every interval (first axis) that each interval made, to first order.

    Args:
        transition: derivative of an interval's end by its first state.
        errors: of an interval's end, from an exact first state.
    """

    def through(parts, interval):
        number, matrix = interval
        parts = (parts @ matrix.T).at[number].set(errors[number])
        return parts, parts

    return jax.lax.scan(through, jnp.zeros_like(errors), (jnp.arange(errors.shape[0]), transition))[1]


def _level(parts: Float[Array, "intervals"]) -> Scalar:
    """Level to which the largest parts of an error must fall so that their sum has the accuracy.

    With all parts above the level brought down to it, the sum is the accuracy. This changes the fewest of them.
    """
    ascending = jnp.sort(parts)
    smaller = jnp.concatenate([jnp.zeros(1, parts.dtype), jnp.cumsum(ascending)[:-1]])
    from_here_up = jnp.arange(parts.shape[0], 0, -1, dtype=parts.dtype)
    return jnp.max((ACCURACY - smaller) / from_here_up)


def bounded(problem: ScaledTimeProblem, most: Nodes, least: Nodes | float = 0.0) -> ScaledTimeProblem:
    """The problem with a greatest dilation of each node, as far as its least one allows, and a least one."""
    allowed = jnp.maximum(most, 2.0 * problem.dilation_min)
    # A least dilation of each node, too, so that tapes of all bounded problems are traced once.
    return dataclasses.replace(
        problem,
        dilation_min=jnp.maximum(problem.dilation_min, jnp.full_like(most, least)),
        dilation_max=jnp.minimum(problem.dilation_max, allowed),
    )
