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
    STAGES,
    Grid,
    Linearisation,
    active_points,
    at_points,
    controls_at,
    extended_rate,
    fly,
    interval_data,
    interval_rate,
    path_outputs,
    rk6_step,
    stage_shares,
    step_begins,
    step_size,
)
from jaxscp.lagrangian import FlightMultipliers
from jaxscp.problem import OptimalControlProblem


@eqx.filter_jit  # traced once for all calls of one program
def expand(
    problem: OptimalControlProblem, z: Float[Array, "nodes variables"], y: FlightMultipliers, grid: Grid
) -> tuple[Linearisation, Float[Array, "intervals inputs inputs"]]:
    """Every interval linearised, and the second derivatives of the Lagrangian, a block an interval.

    Nothing couples intervals but linearly. What holds at nodes alone, the conditions at both ends and the terminal cost
    have second derivatives of their own, which are left out.
    """

    def one(w, given, flow, values):
        def lagrangian(states, controls, cost):
            out = path_outputs(problem, states, controls, cost, given)
            return out.cost + jnp.dot(flow, out.end) - sum(map(jnp.vdot, values, out.values))

        nothing = jnp.zeros((grid.points * grid.steps, STAGES, problem.state_size + 1), w.dtype)
        prices = jax.grad(lambda extra: lagrangian(*fly(problem, w, grid, extra)))(nothing)
        path, tangent, curvature = _sweep(problem, w, grid, prices)

        def push(tangent):
            return jax.jvp(lambda s, u, cost: path_outputs(problem, s, u, cost, given), path, tangent)

        def straight(d):
            return lagrangian(*(v + t @ d for v, t in zip(path, tangent, strict=True)))

        linear = Linearisation(*jax.vmap(push, in_axes=-1, out_axes=(None, -1))(tangent))
        return linear, curvature + jax.hessian(straight)(jnp.zeros_like(w))

    held = tuple(  # on the central path, what does not hold has a price all the same
        jnp.where(active_points(c, v.shape[1])[:, :, None], v, 0.0)
        for c, v in zip(problem.constraints, y.by_interval(), strict=True)
    )
    return jax.vmap(one)(interval_inputs(problem, z), interval_data(problem, grid), y.flow, held)


def _sweep(problem: OptimalControlProblem, w: Float[Array, "inputs"], grid: Grid, prices):
    """The path of ``fly``, its tangent, and the stages' part of the curvature."""
    n, size = problem.state_size, step_size(grid)

    def priced(argument, price):
        return jnp.dot(extended_rate(problem, argument[:n], argument[n:]), price)

    def forward(carry, at):
        extended, tangent, curvature = carry
        share, price = at

        def step(extended, w):
            after, states = rk6_step(interval_rate(problem, w), share, extended, size)
            controls = controls_at(problem, w, stage_shares(share, size))
            return after, jnp.concatenate([states[:, :n], controls], axis=1)

        def push(dx, dw):
            return jax.jvp(step, (extended, w), (dx, dw))

        (extended, arguments), (tangent, moved) = jax.vmap(push, in_axes=-1, out_axes=(None, -1))(
            tangent, jnp.eye(w.shape[0], dtype=w.dtype)
        )
        second = jax.vmap(jax.hessian(priced))(arguments, price)
        curvature += jnp.tensordot(moved, second @ moved, axes=((0, 1), (0, 1)))
        return (extended, tangent, curvature), (extended, tangent)

    at_start = jnp.eye(n + 1, w.shape[0], dtype=w.dtype).at[n].set(0.0)
    flat = jnp.zeros((w.shape[0], w.shape[0]), w.dtype)
    start = (jnp.append(w[:n], 0.0), at_start, flat)
    (_, _, curvature), (path, tangents) = jax.lax.scan(forward, start, (step_begins(grid, w), prices))

    def push(dpath, dw):
        return jax.jvp(lambda path, w: at_points(problem, w, grid, path), (path, w), (dpath, dw))

    values, moved = jax.vmap(push, in_axes=-1, out_axes=(None, -1))(
        tangents, jnp.eye(w.shape[0], dtype=w.dtype)
    )
    return values, moved, curvature
