"""The mesh of a result: whether its intervals are short enough to integrate, and bounds on those that are not.

A free mesh may leave one interval so long that the integration, of fixed steps, gains from its own errors there. Twice
the steps tell the error. As in mesh refinement (Betts, Practical Methods for Optimal Control, 2010, section 4.7), the
order of the method tells how short the interval must be.
"""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Nodes
from jaxscp.problem.node_values import typical_sizes
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.transcription.shooting import Grid, evaluate

ACCURACY = 3e-6  # of an interval's end, in typical sizes; the flight's end may have a hundred times that
ORDER = 7  # of an interval's error in its length
RESERVE = 0.9  # of the length that the order tells
SHORTEST = 0.3  # times its length, that an interval is bounded to at once


def bounds(problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Nodes:
    """Greatest dilation of each node that keeps its intervals accurate; infinite where they are."""
    finer = dataclasses.replace(grid, steps=2 * grid.steps)
    errors = evaluate(problem, z, grid).end - evaluate(problem, z, finer).end
    excess = jnp.linalg.norm(errors / typical_sizes(z)[: problem.state_size], axis=1) / ACCURACY
    lengths = jnp.maximum(z[:-1, -1], z[1:, -1])
    shorter = lengths * jnp.maximum(RESERVE * jnp.maximum(excess, 1.0) ** (-1.0 / ORDER), SHORTEST)
    interval = jnp.where(excess > 1.0, shorter, jnp.inf)
    none = jnp.full((1,), jnp.inf)
    return jnp.minimum(jnp.concatenate([interval, none]), jnp.concatenate([none, interval]))


def bounded(problem: ScaledTimeProblem, most: Nodes, least: Nodes | float = 0.0) -> ScaledTimeProblem:
    """The problem with a greatest dilation of each node, as far as its least one allows, and a least one."""
    allowed = jnp.maximum(most, 2.0 * problem.dilation_min)
    return dataclasses.replace(
        problem,
        dilation_min=jnp.maximum(problem.dilation_min, least),
        dilation_max=jnp.minimum(problem.dilation_max, allowed),
    )
