"""Typical sizes of a problem with a scale: given ones, and those measured at the guess. They have no derivatives."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.boundary import END_TOLERANCE, Boundary
from jaxscp.problem.constraint import Constraint
from jaxscp.problem.cost import Cost
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scale import Scale
from jaxscp.problem.trajectory import Trajectory

ALIKE = 30.0
"""Rows of one constraint or group whose sizes differ by less share one."""
_ROUNDING = (
    1e-16  # of the largest size: a smaller one counts as none; metres of an orbit stand beside its thrust
)


class Sizes(eqx.Module):
    """Sizes of all quantities of a problem."""

    state: Float[Array, "states"]
    control: Float[Array, "controls"]
    time: Scalar
    cost: Scalar
    initial: Float[Array, "_"]
    """Of the rows of the initial condition."""
    final: Float[Array, "_"]
    """Of the rows of the final condition."""
    coupled: Float[Array, "_"] | None
    """Of the rows of the condition on both ends."""


def measured_sizes(problem: OptimalControlProblem, scale: Scale, guess: Trajectory) -> Sizes:
    """Sizes of the scale, and sizes of cost and end conditions at the guess."""
    problem, scale, guess = jax.lax.stop_gradient((problem, scale, guess))
    ends = problem.boundary
    first, last, final_time = guess.state[0], guess.state[-1], guess.time[-1]
    coupled = None
    if ends.coupled is not None:
        jacobian = jax.jacfwd(ends.coupled.value)(first, last, final_time)
        coupled = _row_sizes(jacobian, scale.state)
    return Sizes(
        state=scale.state,
        control=scale.control,
        time=scale.time,
        cost=_size_of_cost(problem.cost, guess) if scale.cost is None else scale.cost,
        initial=_row_sizes(jax.jacfwd(ends.initial.value)(first, 0.0), scale.state),
        final=_row_sizes(jax.jacfwd(ends.final.value)(last, final_time), scale.state),
        coupled=coupled,
    )


def _row_sizes(jacobian: Float[Array, "rows inputs"], sizes: Float[Array, "inputs"]) -> Float[Array, "rows"]:
    """Change of each row if every input changes by its own size; one where that is nothing."""
    return or_one(jnp.abs(jacobian) @ sizes)


def or_one(size: Array) -> Array:
    """The size, or one where there is none."""
    return jnp.where(size > 0.0, size, 1.0)


def _size_of_cost(cost: Cost, guess: Trajectory) -> Scalar:
    """Cost of a guess, by the trapezium rule; one where it costs nothing."""
    parameters = cost.node_parameters()
    rate = jax.vmap(cost.running_at)(guess.state, guess.control, guess.time, parameters)
    last = jax.tree.map(lambda v: v[-1], parameters)
    running = jnp.sum(0.5 * (rate[1:] + rate[:-1]) * jnp.diff(guess.time))
    return or_one(jnp.abs(running + cost.terminal_at(guess.state[-1], guess.time[-1], last)))


def sizes_of_rows(sizes: Float[Array, "rows"]) -> Float[Array, "rows"]:
    """The largest size for all rows, but for those that are far smaller: a force beside an angle, say."""
    largest = or_one(jnp.max(sizes))
    return jnp.where((ALIKE * sizes < largest) & (sizes > _ROUNDING * largest), sizes, largest)


def size_of_constraint(c: Constraint, scale: Scale, guess: Trajectory) -> Float[Array, "*rows"]:
    """Largest change of the values if state and control change by their own sizes, at the guess.

    One number for a curved cone and a soft constraint, whose rows belong together; else one for each row.
    """
    c, scale, guess = jax.lax.stop_gradient((c, scale, guess))
    function = c.with_parameters(c.function)
    if c.where.across:
        both = jnp.append(scale.control, scale.time)
        sizes, intervals = jnp.concatenate([both, both]), guess.nodes - 1
        ends = jnp.concatenate([guess.control, guess.dilation[:, None]], axis=1)
        parameters = jax.tree.map(lambda v: v[:-1], c.node_parameters())
        slopes = jax.jacfwd(lambda a, b, p: function(a, b, 1.0 / intervals, p), argnums=(0, 1))
        jacobian = jnp.concatenate(jax.vmap(slopes)(ends[:-1], ends[1:], parameters), axis=-1)
    else:
        sizes = jnp.concatenate([scale.state, scale.control])
        slopes = jax.jacfwd(function, argnums=(0, 1))
        found = jax.vmap(slopes)(guess.state, guess.control, guess.time, c.node_parameters())
        jacobian = jnp.concatenate(found, axis=-1)
    changes = jnp.max(jnp.abs(jacobian) @ sizes, axis=0)
    together = c.cone.curved or c.soft is not None
    return or_one(jnp.max(changes)) if together else sizes_of_rows(changes)


class EndMeasure(NamedTuple):
    """How a certificate measures a group of rows of an end condition."""

    weights: Float[Array, "rows"]
    """Factors of the rows, greater for those of far smaller size."""
    tolerance: Array


def end_measures(boundary: Boundary, sizes: Sizes | None) -> dict[str, list[EndMeasure]]:
    """Measure of each group of rows, for the start, the end, and both."""
    found: dict[str, list[EndMeasure]] = {}
    for where in ("initial", "final", "coupled"):
        condition, first = getattr(boundary, where), 0
        for rows in condition.rows if condition is not None else ():
            own = jnp.ones(rows.count)
            if sizes is not None and rows.tolerance is None:
                own = sizes_of_rows(getattr(sizes, where)[first : first + rows.count])
            largest = jnp.max(own)
            given = END_TOLERANCE * largest if rows.tolerance is None else jnp.asarray(rows.tolerance, float)
            found.setdefault(where, []).append(EndMeasure(largest / own, given))
            first += rows.count
    return found
