"""The convex quadratic model of the cost that a subproblem of ``NewtonSCP`` minimises.

Far from the optimum the Hessian is projected block by block, which makes steps short and safe. Once the proximal weight
has fallen, it is convexified along the horizon, which is exact at the optimum.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core import batching
from jaxscp.core.types import Flag
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.active_set import active_set, nearest_dilation_limit, slacks
from jaxscp.scp.hessian_convexification import LinearDynamics, convexified_along_horizon, projected
from jaxscp.scp.second_order_correction import ACTIVE_PENALTY
from jaxscp.scp.state import NewtonState
from jaxscp.transcription.layout import stage_sizes


class ConvexModel(eqx.Module):
    """A convex quadratic for every stage."""

    hessian: Float[Array, "nodes inputs inputs"]
    """In the variables' own units, with the proximal term."""
    gradient: Float[Array, "nodes inputs"]
    """Added to the gradient of the cost."""
    metric: Float[Array, "intervals inputs inputs"]
    """Projected Hessian in scaled units: the metric of second-order corrections."""
    scale: Float[Array, "inputs"]
    """Typical sizes of an interval's variables."""


class _Quadratic(eqx.Module):
    """A quadratic for every stage, in scaled units."""

    hessian: Float[Array, "nodes inputs inputs"]
    gradient: Float[Array, "nodes inputs"]


def convex_model(problem: ScaledTimeProblem, state: NewtonState) -> ConvexModel:
    """The model about the reference."""
    scale = stage_sizes(problem, state.scale)
    stage, inputs = problem.variables, scale.shape[0]
    metric = projected(scaled_hessian(state.hessian, scale)).hessian
    of_node = (jnp.arange(inputs) < stage).astype(scale.dtype)  # the proximal term counts each node once
    end = _terminal_hessian(problem, state, scale)
    plain = _Quadratic(
        hessian=jnp.pad(metric, ((0, 1), (0, 0), (0, 0))) + state.proximal * jnp.diag(of_node),
        gradient=jnp.zeros((problem.nodes, inputs), scale.dtype),
    )
    chosen = batching.where_needed(
        state.full_hessian,
        lambda fixed, _, needed: _along_horizon(*fixed, needed=needed),
        (problem, state, scale),
        plain,
    )
    hessian = chosen.hessian.at[-1].add(jnp.diag(1.0 - of_node))  # the last stage's U_{i+1} has no meaning
    if end is not None:
        hessian = hessian.at[-1, : problem.state_size, : problem.state_size].add(end.convex)
    return ConvexModel(hessian / scale / scale[:, None], chosen.gradient / scale, metric, scale)


def _along_horizon(
    problem: ScaledTimeProblem, state: NewtonState, scale: Float[Array, "inputs"], needed: Flag
) -> _Quadratic:
    """Convexified along the horizon, with a penalty on leaving the last subproblem's active constraints."""
    n, stage = problem.state_size, problem.variables
    inputs, now = scale.shape[0], state.residual
    active = active_set(problem, state.linear, state.multipliers, scale)
    proximal = state.proximal * jnp.diag((jnp.arange(inputs) < stage).astype(scale.dtype))
    at_limit = ACTIVE_PENALTY * active.dilation[:, None] * jnp.eye(inputs, dtype=scale.dtype)[stage - 1]
    beyond = (state.z[:, -1] - nearest_dilation_limit(problem, state.z[:, -1])) / scale[stage - 1]

    penalised = (
        scaled_hessian(state.hessian, scale)
        + ACTIVE_PENALTY * active.hessian()
        + jax.vmap(jnp.diag)(at_limit[:-1])
    )
    ends = state.linear.final.jacobian * scale[:n]
    final = jnp.diag(
        at_limit[-1, :stage] + 0.5 * state.proximal * (jnp.arange(stage) >= n).astype(scale.dtype)
    )
    final = final.at[:n, :n].add(ACTIVE_PENALTY * ends.T @ ends)
    if (end := _terminal_hessian(problem, state, scale)) is not None:
        final = final.at[:n, :n].add(end.rest)
    dynamics = LinearDynamics(state.linear.jacobian.end * scale / scale[:n, None], now.defect / scale[:n])
    convex = convexified_along_horizon(penalised + 0.5 * proximal, dynamics, final, needed)
    slack_gradient = active.penalty_gradient(slacks(problem, state.linear.outputs))
    gradient = ACTIVE_PENALTY * slack_gradient + convex.gradient
    return _Quadratic(
        hessian=jnp.pad(convex.hessian, ((0, 1), (0, 0), (0, 0))) + 0.5 * proximal,
        gradient=jnp.pad(gradient, ((0, 1), (0, 0))) + at_limit * beyond[:, None],
    )


class _TerminalHessian(eqx.Module):
    """Second derivatives of the terminal cost in scaled units, as the sum of two parts."""

    convex: Float[Array, "states states"]
    """Belongs to the last node's quadratic."""
    rest: Float[Array, "states states"]
    """Negative curvature, which the convexification moves along the horizon."""


def _terminal_hessian(
    problem: ScaledTimeProblem, state: NewtonState, scale: Float[Array, "inputs"]
) -> _TerminalHessian | None:
    """None for a terminal cost without second derivatives."""
    if not problem.curved_end:
        return None
    whole = scaled_hessian(problem.terminal_hessian(state.z), scale[: problem.state_size])
    values, vectors = jnp.linalg.eigh(whole)
    convex = (vectors * jnp.maximum(values, 0.0)) @ vectors.T
    return _TerminalHessian(convex, whole - convex)


def scaled_hessian(hessian: Float[Array, "*b n n"], scale: Float[Array, "n"]) -> Float[Array, "*b n n"]:
    """The Hessian with respect to scaled variables."""
    return hessian * scale * scale[:, None]
