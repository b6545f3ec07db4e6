"""The convex step of a tick: the tracking cost on the linearised horizon, as a program of the controls alone.

States are eliminated (condensing). With ten intervals, 13 states and 4 controls, an interior-point step on the 40
controls costs a tenth of one Riccati recursion over the states.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.control.actuators import Actuators
from jaxscp.control.bounded_qp import BoundedQP
from jaxscp.control.prediction import Plan
from jaxscp.control.tracking import Tracking


def tracking_qp(
    tracking: Tracking,
    actuators: Actuators,
    plan: Plan,
    reference,
    sensitivities,
    grid: Float[Array, "nodes"],
) -> BoundedQP:
    """Gauss-Newton program in the controls of all nodes after the first.

    Args:
        tracking: weights and error.
        actuators: limits.
        plan: nodes of the linearisation.
        reference: (nodes, states) and (nodes, controls) to follow.
        sensitivities: (intervals, states, columns), by ``prediction.sensitivities``.
        grid: of the nodes, s from the first.
    """
    lengths = jnp.diff(grid)
    states, controls = reference

    def error(state, target):
        value = lambda x: tracking.error(x, target)  # noqa: E731
        return value(state), jax.jacfwd(value)(state)

    value, of_state = jax.vmap(error)(plan.state[1:], states[1:])
    weight = _node_weights(lengths)[:, None] * tracking.state
    root = jnp.sqrt(weight.at[-1].add(tracking.final))
    columns = root[:, :, None] * (of_state @ sensitivities).at[:, :, 0].add(value)
    columns = columns.reshape(-1, columns.shape[2])
    residual, rows = columns[:, 0], columns[:, 1:]
    tracked = rows.T @ rows
    of_controls, gradient = _control_cost(tracking, lengths, controls, plan.control[0])
    at_plan = rows.T @ residual - tracked @ plan.control[1:].ravel()
    change = lengths[:, None] * jnp.broadcast_to(actuators.rate, plan.control[0].shape)
    limits = lambda bound: jnp.broadcast_to(bound, change.shape)  # noqa: E731
    return BoundedQP(
        of_controls + tracked,
        gradient + at_plan.reshape(gradient.shape),
        plan.control[0],
        jnp.stack([limits(actuators.lower), -change]),
        jnp.stack([limits(actuators.upper), change]),
    )


def centre(actuators: Actuators, before: Float[Array, "controls"], grid: Array) -> Float[Array, "n controls"]:
    """Controls strictly within all limits: from the active ones to the middle, at half the greatest rate.

    Args:
        actuators: limits; where one is infinite, the active control is the middle.
        before: (controls,) active controls, within their bounds.
        grid: of the nodes, s from the first.
    """
    bounded = jnp.isfinite(actuators.lower) & jnp.isfinite(actuators.upper)
    middle = 0.5 * (jnp.where(bounded, actuators.lower, 0.0) + jnp.where(bounded, actuators.upper, 0.0))
    away = jnp.where(bounded, middle - before, 0.0)
    reach = 0.5 * actuators.rate * grid[1:, None]
    return before + jnp.clip(away, -reach, reach)


def _node_weights(lengths: Float[Array, "intervals"]) -> Float[Array, "intervals"]:
    """Weights of the trapezoidal rule, of the nodes after the first: that one is given."""
    return 0.5 * (lengths + jnp.append(lengths[1:], 0.0))


def _control_cost(tracking: Tracking, lengths: Array, reference: Array, before: Array):
    """Hessian and gradient of the weights of the controls and their rates, at controls of zero."""
    count, controls = lengths.shape[0], before.shape[0]
    change = jnp.eye(count) - jnp.eye(count, k=-1)
    of_control = _node_weights(lengths)[:, None] * tracking.control
    of_rate = tracking.control_rate / lengths[:, None]
    blocks = jnp.einsum("kc,ki,kj->ijc", of_rate, change, change)
    blocks = blocks + jnp.eye(count)[:, :, None] * of_control[:, None, :]
    hessian = jnp.einsum("ijc,cd->icjd", blocks, jnp.eye(controls)).reshape(count * controls, -1)
    # controls that cost nothing: the reference, moved by the first node's difference for the rates
    slope = jnp.diff(reference, axis=0).at[0].add(before)
    gradient = -of_control * reference[1:] - jnp.einsum("ki,kc->ic", change, of_rate * slope)
    return hessian, gradient
