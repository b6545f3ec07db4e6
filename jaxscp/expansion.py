"""Intervals to second order, in one pass: outputs, Jacobians, and the curvature of the Lagrangian.

An interval is a chain of Runge-Kutta stages, and all that is asked of it a function Phi of the path that these leave at
its points, so that

    d2L/dw2 = sum_j S_j' D2(kappa_j . rate)(s_j) S_j + D2 Phi, along the path's tangent

with s_j the state and control that slope j is taken at, S_j their Jacobian in w, and kappa_j the price of the slope:
how L changes where something is added to it. Nothing is approximate here. Forward over reverse mode through the
integration gives the same, but goes through the chain anew for every direction.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.discretise import interval_inputs
from jaxscp.intervals import (
    METHOD,
    Grid,
    Linearisation,
    active_points,
    at_points,
    fly,
    interval_data,
    path_outputs,
)
from jaxscp.lagrangian import FlightMultipliers
from jaxscp.problem import OptimalControlProblem
from jaxscp.sweeps import Intervals, sweep


@eqx.filter_jit  # traced once for all calls of one program
def expand(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers, grid: Grid
) -> tuple[Linearisation, Float[Array, "intervals inputs inputs"]]:
    """Every interval linearised, and the second derivatives of the Lagrangian, a block an interval.

    Nothing couples intervals but linearly. What holds at nodes alone, the conditions at both ends and the terminal cost
    have second derivatives of their own, which are left out.
    """

    def lagrangian(path, rest):
        given, flow, values = rest
        states, controls, cost = path
        out = path_outputs(problem, states, controls, cost, given)
        return out.cost + jnp.dot(flow, out.end) - sum(map(jnp.vdot, values, out.values))

    def prices(w, *rest):
        nothing = jnp.zeros((grid.all_steps, METHOD.stages, problem.state_size + 1), w.dtype)
        return jax.grad(lambda push: lagrangian(fly(problem, w, grid, push), rest))(nothing)

    def along(w, path, tangent, *rest):
        """What follows from an interval's path, and the curvature that is not the integration's."""
        points = lambda path, w: at_points(problem, w, grid, path)  # noqa: E731
        push = lambda dpath, dw: jax.jvp(points, (path, w), (dpath, dw))  # noqa: E731
        directions = jnp.eye(w.shape[0], dtype=w.dtype)
        path, tangent = jax.vmap(push, in_axes=-1, out_axes=(None, -1))(tangent, directions)

        def straight(d):
            return lagrangian([v + t @ d for v, t in zip(path, tangent, strict=True)], rest)

        outputs = lambda s, u, cost: path_outputs(problem, s, u, cost, rest[0])  # noqa: E731
        follow = lambda tangent: jax.jvp(outputs, path, tangent)  # noqa: E731
        linear = Linearisation(*jax.vmap(follow, in_axes=-1, out_axes=(None, -1))(tangent))
        return linear, jax.hessian(straight)(jnp.zeros_like(w))

    held = tuple(  # on the central path, what does not hold has a price all the same
        jnp.where(active_points(c, v.shape[1])[:, :, None], v, 0.0)
        for c, v in zip(problem.constraints, y.by_interval(), strict=True)
    )
    w, rest = interval_inputs(problem, z), (interval_data(problem, grid), y.flow, held)
    intervals = Intervals(problem.slope, problem.state_size, METHOD, grid.all_steps, grid.steps)
    found = sweep(intervals, w, jax.vmap(prices)(w, *rest))
    linear, curvature = jax.vmap(along)(w, found.path, found.tangent, *rest)
    return linear, found.curvature + curvature
