"""What a subproblem of ``newton`` minimises, and what it foretells: a convex quadratic about an iterate.

Far from the optimum curvature is projected block by block, which keeps steps short and safe; once the proximal
weight has fallen, it is condensed along the chain, which is exact at the end.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.scp.active_set import active_set, nearest_dilation_limit, slacks
from jaxscp.scp.hessian_convexification import Convex, LinearDynamics, condensed
from jaxscp.scp.second_order_correction import HOLD
from jaxscp.scp.state import NewtonState
from jaxscp.scp.subproblem import buffered
from jaxscp.transcription.lagrangian import Residual
from jaxscp.transcription.layout import interval_inputs


def convex_model(
    problem: OptimalControlProblem,
    state: NewtonState,
    now: Residual,
    clipped: Convex,
    scale: Float[Array, "inputs"],
):
    """Hessian and extra gradient of every stage, in the variables' own units."""
    stage, inputs = problem.variables, scale.shape[0]
    own = (jnp.arange(inputs) < stage).astype(scale.dtype)  # the proximal term counts each node once
    near = state.proximal * jnp.diag(own)
    plain = Model(
        hessian=jnp.pad(clipped.hessian, ((0, 1), (0, 0), (0, 0))) + near,
        gradient=jnp.zeros((problem.nodes, inputs), scale.dtype),
    )
    model = batching.where_needed(
        state.exact, lambda fixed, _: _exact(*fixed), (problem, state, now, scale), plain
    )
    hessian = model.hessian.at[-1].add(jnp.diag(1.0 - own))  # the last stage's third part is idle
    return hessian / scale / scale[:, None], model.gradient / scale


class Model(eqx.Module):
    """A convex quadratic for every stage, in scaled units."""

    hessian: Float[Array, "nodes inputs inputs"]
    gradient: Float[Array, "nodes inputs"]


def _exact(
    problem: OptimalControlProblem, state: NewtonState, now: Residual, scale: Float[Array, "inputs"]
) -> Model:
    """Condensed along the chain, with the constraints held that the last subproblem found active."""
    n, stage = problem.state_size, problem.variables
    inputs = scale.shape[0]
    active = active_set(problem, state.linear, state.multipliers, scale)
    near = state.proximal * jnp.diag((jnp.arange(inputs) < stage).astype(scale.dtype))
    at_limit = HOLD * active.dilation[:, None] * jnp.eye(inputs, dtype=scale.dtype)[stage - 1]
    beyond = (state.z[:, -1] - nearest_dilation_limit(problem, state.z[:, -1])) / scale[stage - 1]

    held = (
        scaled_hessian(state.curvature, scale) + HOLD * active.curvature() + jax.vmap(jnp.diag)(at_limit[:-1])
    )
    ends = state.linear.final.jacobian * scale[:n]
    final = jnp.diag(
        at_limit[-1, :stage] + 0.5 * state.proximal * (jnp.arange(stage) >= n).astype(scale.dtype)
    )
    final = final.at[:n, :n].add(HOLD * ends.T @ ends)
    chain = LinearDynamics(state.linear.jacobian.end * scale / scale[:n, None], now.defect / scale[:n])
    convex = condensed(held + 0.5 * near, chain, final)
    pull = HOLD * active.pull(slacks(problem, state.linear.outputs)) + convex.gradient
    return Model(
        hessian=jnp.pad(convex.hessian, ((0, 1), (0, 0), (0, 0))) + 0.5 * near,
        gradient=jnp.pad(pull, ((0, 1), (0, 0))) + at_limit * beyond[:, None],
    )


def foretold(
    problem: OptimalControlProblem, now: Residual, slope, hessian, stages, move, virtual
) -> Residual:
    """What the model makes of the point that a step leads to: feasible but for virtual control and buffer."""
    w = interval_inputs(problem, move)
    cost = now.cost + slope + 0.5 * jnp.einsum("iw,iwv,iv->", w, hessian, w)
    lack = -stages[:-1, -1:, None] if buffered(problem) else jnp.zeros(())
    values = tuple(
        jnp.broadcast_to(jnp.zeros(()) if c.convex else lack, v.shape)
        for c, v in zip(problem.constraints, now.values, strict=True)
    )
    return Residual(cost, virtual, values)


def scaled_hessian(hessian: Float[Array, "*b n n"], scale: Float[Array, "n"]) -> Float[Array, "*b n n"]:
    """By the units of the variables."""
    return hessian * scale * scale[:, None]
