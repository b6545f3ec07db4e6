"""Cost of a deviation from the reference: weights, and the error whose squares they weigh."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.dynamics import rotations
from jaxscp.dynamics.base import Dynamics
from jaxscp.dynamics.rigid_body import RigidBody

FLIGHT_WEIGHTS = 60.0, 6.0, 6.0, 0.3
"""Of position (1/m^2), velocity (s^2/m^2), attitude and body rate (s^2)."""
FINAL = 0.5  # s: final weights over running ones


def difference(state: Float[Array, "states"], reference: Float[Array, "states"]) -> Float[Array, "states"]:
    """State less reference."""
    return state - reference


def flight_error(state: Float[Array, "13"], reference: Float[Array, "13"]) -> Float[Array, "12"]:
    """Position, velocity, attitude and body rate less the reference's.

    The attitude's error is twice the vector part of the rotation from the reference: radians in body axes, to first
    order. Three numbers suffice, as the dynamics keep the quaternion's norm.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxscp.control.tracking import flight_error
        >>> level = jnp.zeros(13).at[6].set(1.0)
        >>> (flight_error(level.at[2].set(0.5).at[6].set(-1.0), level)[:9] + 0.0).tolist()
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """
    turn = 2.0 * rotations.attitude_error(state[6:10], reference[6:10])
    return jnp.concatenate([state[:6] - reference[:6], turn, state[10:] - reference[10:]])


class Tracking(eqx.Module):
    """Least-squares cost: the integral over the horizon of the weighted squares, and the final weighted squares.

    Args:
        state: (errors,) weights of the error, a second.
        final: (errors,) weights of the error at the end of the horizon.
        control: (controls,) weights of the control less the reference's, a second.
        control_rate: (controls,) weights of its rate of change less the reference's, a second.
        error: (state, reference) -> (errors,); ``flight_error`` or ``difference``, or an own function.
    """

    state: Float[Array, "errors"] = eqx.field(converter=as_floats)
    final: Float[Array, "errors"] = eqx.field(converter=as_floats)
    control: Float[Array, "controls"] = eqx.field(converter=as_floats)
    control_rate: Float[Array, "controls"] = eqx.field(converter=as_floats)
    error: Callable[..., Array] = eqx.field(default=difference, static=True)

    @staticmethod
    def of(dynamics: Dynamics) -> "Tracking":
        """Default weights: for a rigid body, weights of a small multirotor; else ones.

        Example:
            >>> import jaxscp
            >>> jaxscp.control.Tracking.of(jaxscp.airframes.paper_mav().body).state.shape
            (12,)
        """
        n, m = dynamics.state_size, dynamics.control_size
        if isinstance(dynamics, RigidBody):
            state = np.repeat(FLIGHT_WEIGHTS, 3)
            return Tracking(state, FINAL * state, np.full(m, 0.02), np.full(m, 2e-4), flight_error)
        return Tracking(np.ones(n), np.ones(n), np.full(m, 1e-2), np.full(m, 1e-4))
