"""One interval of the flight as a function of its own variables: where it ends, what it costs, how safe it is.

An interval's variables are w = (x_i, U_i, U_{i+1}): the state at its first node, and controls with their dilation
at both. Path constraints hold at equally spaced points of every interval, its ends included, and between those
points by a margin: where a value's second difference over three points is d, the value dips below the chord by
d / 8 at most (to fourth order), so that much, and a tenth more, is asked for at the points.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxscp import runge_kutta
from jaxscp.constraints import AcrossIntervals, AtNodes, Constraint, SecondOrder
from jaxscp.discretise import interval_inputs
from jaxscp.problem import OptimalControlProblem
from jaxscp.sweeps import controls_at
from jaxscp.types import Scalar

METHOD = runge_kutta.SIXTH_ORDER
RESERVE = 1.1  # of the margin: a path may bend more between the points than at them
_KINK = 1e-4  # m, or a value's unit: rounds the corner of max(0, d); a sixteenth of it may be missed


class Grid(eqx.Module):
    """Where an interval is integrated and constrained.

    Args:
        points: stretches between the points at which constraints hold.
        steps: sixth-order Runge-Kutta steps of a stretch.
    """

    points: int = eqx.field(default=5, static=True)
    steps: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.points < 3 or self.steps < 1:
            raise ValueError(f"a grid needs 3 points and 1 step or more, not {self.points} and {self.steps}")

    @property
    def all_steps(self) -> int:
        """Runge-Kutta steps of an interval."""
        return self.points * self.steps


class Outputs(eqx.Module):
    """What intervals give, the intervals as leading axis if there are many; in Jacobians inputs are the last axis."""

    end: Float[Array, "..."]
    """(states,)"""
    cost: Float[Array, "..."]
    """(), the running cost."""
    values: tuple[Float[Array, "..."], ...]
    """(points, rows) of every constraint, less the margin; of those that do not hold throughout, at one point."""


class Linearisation(eqx.Module):
    """Outputs and their Jacobians with respect to w; the variables come last."""

    outputs: Outputs
    jacobian: Outputs


def interval_outputs(problem: OptimalControlProblem, w: Float[Array, "inputs"], given, grid: Grid) -> Outputs:
    """Fly one interval; ``given`` is its entry of ``interval_data``."""
    return path_outputs(problem, *fly(problem, w, grid), given)


def path_outputs(
    problem: OptimalControlProblem,
    states: Float[Array, "points states"],
    controls: Float[Array, "points inputs"],
    cost: Scalar,
    given,
) -> Outputs:
    """What a flown interval gives, from its states and controls (with dilation) at the points."""
    parameters, keep = given
    values = tuple(
        _values(problem, constraint, p, keep, states, controls)
        for constraint, p in zip(problem.constraints, parameters, strict=True)
    )
    return Outputs(states[-1], cost, values)


@eqx.filter_jit  # traced once for all calls of one program
def evaluate(problem: OptimalControlProblem, z: Float[Array, "nodes variables"], grid: Grid) -> Outputs:
    """Outputs of every interval."""
    one = lambda w, p: interval_outputs(problem, w, p, grid)  # noqa: E731
    return jax.vmap(one)(interval_inputs(problem, z), interval_data(problem, grid))


def linearise(
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    grid: Grid,
    outputs: Callable[..., Outputs] = interval_outputs,
) -> Linearisation:
    """Outputs of every interval and their Jacobians, by forward mode through the integration that ``outputs`` does."""

    def one(w, given):
        push = lambda v: jax.jvp(lambda w: outputs(problem, w, given, grid), (w,), (v,))  # noqa: E731
        return Linearisation(*jax.vmap(push, out_axes=(None, -1))(jnp.eye(w.shape[0], dtype=w.dtype)))

    return jax.vmap(one)(interval_inputs(problem, z), interval_data(problem, grid))


def interval_data(problem: OptimalControlProblem, grid: Grid):
    """For every interval: each constraint's parameters at its first node, and where the margin is kept.

    The flight's two ends have none: there the boundary decides, and a goal may lie on the floor of its corridor.
    """
    parameters = tuple(jax.tree.map(lambda p: p[:-1], c.parameters) for c in problem.constraints)
    keep = jnp.ones((problem.nodes - 1, grid.points + 1)).at[0, 0].set(0.0).at[-1, -1].set(0.0)
    return parameters, keep


def active_points(constraint: Constraint, points: int) -> Bool[Array, "intervals points"]:
    """Where a constraint holds: in the intervals of its active nodes, and at the last node only if active there.

    A landing cone, say, is left out at its apex, where the goal itself holds the vehicle.
    """
    active = jnp.broadcast_to(constraint.active[:-1, None], (constraint.active.shape[0] - 1, points))
    last_point = active[-1, -1] & (constraint.active[-1] | (points == 1))
    return active.at[-1, -1].set(last_point)


def fly(problem: OptimalControlProblem, w: Float[Array, "inputs"], grid: Grid, push: Array | None = None):
    """States and controls (with dilation) at the points, and the running cost.

    Args:
        problem: gives dynamics and running cost.
        w: the interval's variables.
        grid: of points and steps.
        push: (all steps, stages, states + 1), added to the slopes of the stages; of use for its derivatives.
    """
    n = problem.state_size

    @jax.checkpoint  # reverse mode keeps no more of a stage than its state
    def rate(share, extended):
        return problem.slope(extended[:n], controls_at(w, n, share))

    path = runge_kutta.integrate(METHOD, rate, jnp.append(w[:n], 0.0), grid.all_steps, push)
    return at_points(problem, w, grid, path[grid.steps - 1 :: grid.steps])


def at_points(
    problem: OptimalControlProblem,
    w: Float[Array, "inputs"],
    grid: Grid,
    path: Float[Array, "points extended"],
):
    """States and controls (with dilation) at the points, and the running cost, from the state and the cost so far at
    every point but the first."""
    n = problem.state_size
    share = jnp.linspace(0.0, 1.0, grid.points + 1, dtype=w.dtype)
    return jnp.concatenate([w[None, :n], path[:, :n]]), controls_at(w, n, share), path[-1, n]


def _values(problem: OptimalControlProblem, constraint: Constraint, parameters, keep, states, controls):
    if isinstance(constraint.where, AcrossIntervals):
        width = 1.0 / (problem.nodes - 1)
        return constraint.function(controls[0], controls[-1], width, parameters)[None]
    at = lambda x, u: value_at(problem, constraint, x, u, parameters)  # noqa: E731
    if isinstance(constraint.where, AtNodes):
        return at(states[0], controls[0])[None]
    values = jax.vmap(at)(states, controls)
    return values - keep[:, None] * _margin(values, isinstance(constraint.cone, SecondOrder))


def value_at(problem: OptimalControlProblem, constraint: Constraint, state, control, parameters):
    """A constraint's values at a whole state and a control with the dilation last."""
    physical, time = problem.split_state(state)
    return constraint.function(physical, control[:-1], time, parameters)


def _margin(values: Float[Array, "points rows"], second_order: bool) -> Float[Array, "points rows"]:
    """What a value may lack between points; a second-order cone's is all taken from its first component."""
    bend = jnp.diff(values, n=2, axis=0)
    ends = 2.0 * bend[:1] - bend[1:2], 2.0 * bend[-1:] - bend[-2:-1]  # carried on in a straight line
    bend = RESERVE * jnp.concatenate([ends[0], bend, ends[1]])
    if second_order:
        size = jnp.sqrt(jnp.sum(bend * bend, axis=1) + _KINK**2) - _KINK  # nothing at the apex
        return jnp.zeros_like(values).at[:, 0].set(size / 8.0 * jnp.sqrt(2.0))
    return (bend + jnp.sqrt(bend * bend + _KINK**2) - _KINK) / 16.0
