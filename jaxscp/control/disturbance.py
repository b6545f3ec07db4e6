"""Disturbances that change slowly: their effect, an observer, and the reference under them.

A disturbance d adds E d to the state's derivative. The observed quantity is y = E^+ x: of a rigid body, momentum and
angular momentum. In a tick, y grows by the prediction, which contains tick * d. A Kalman filter of (y, tick * d) has
white noise on y and a random walk of d. Its steady-state gains are alpha and beta = alpha^2 / (2 - alpha). Lambda is
the change of tick * d in a tick over the noise of y; Lambda = beta / sqrt(1 - alpha) gives alpha. Source: Kalata, "The
tracking index: a generalized parameter for alpha-beta and alpha-beta-gamma target trackers", 1984.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscp.control.tracking import Tracking
from jaxscp.core.arrays import as_floats, namespace
from jaxscp.core.types import Scalar
from jaxscp.dynamics.base import Dynamics
from jaxscp.dynamics.rigid_body import RigidBody

Disturbance = Float[Array, "disturbances"]
SOFTNESS = 0.1  # tracking cost a second at which the last unit of acceleration is not balanced


class DisturbanceModel(eqx.Module):
    """Effect of the disturbances and noise of their estimate.

    Args:
        effect: (states, disturbances) E, of full column rank.
        noise: (disturbances,) standard deviation of a tick's error of y, in the disturbance's unit times s.
        drift: (disturbances,) random walk of the disturbance, in its unit after one second.
    """

    effect: Float[Array, "states disturbances"] = eqx.field(converter=as_floats)
    noise: Disturbance = eqx.field(converter=as_floats)
    drift: Disturbance = eqx.field(converter=as_floats)
    observed: Float[Array, "disturbances states"]
    """E^+, from ``effect``."""

    def __init__(self, effect, noise, drift):
        self.effect, self.noise, self.drift = (as_floats(v) for v in (effect, noise, drift))
        xp = namespace(self.effect)
        e = xp.asarray(self.effect)
        self.observed = as_floats(xp.linalg.solve(e.T @ e, e.T))

    @staticmethod
    def of(dynamics: Dynamics) -> "DisturbanceModel":
        """Force in the world (N) and torque in body axes (N m) of a rigid body; no disturbance for others.

        Noise: 2 cm/s and 0.03 rad/s. Drift after one second: 1 m/s^2 and 2 rad/s^2, times mass and inertia.

        Example:
            >>> import jaxscp
            >>> jaxscp.control.DisturbanceModel.of(jaxscp.airframes.paper_mav().body).effect.shape
            (13, 6)
        """
        if not isinstance(dynamics, RigidBody):
            return DisturbanceModel(np.zeros((dynamics.state_size, 0)), np.zeros(0), np.zeros(0))
        xp = namespace(dynamics)
        mass, inertia = xp.asarray(dynamics.mass), xp.asarray(dynamics.inertia)
        three = np.ones(3)
        force = xp.concatenate([np.zeros((3, 3)), np.eye(3) / mass, np.zeros((7, 3))])
        torque = xp.concatenate([np.zeros((10, 3)), xp.linalg.inv(inertia)])
        sizes = xp.concatenate([three * mass, xp.diag(inertia)])
        noise, drift = np.repeat([0.02, 0.03], 3), np.repeat([1.0, 2.0], 3)
        return DisturbanceModel(xp.concatenate([force, torque], axis=1), noise * sizes, drift * sizes)

    def gains(self, tick: Scalar | float) -> tuple[Disturbance, Disturbance]:
        """alpha and beta."""
        index = self.drift * tick**1.5 / self.noise
        # with s = sqrt(1 - alpha), Lambda s (1 + s^2) = (1 - s^2)^2 is a quadratic equation of s + 1 / s
        w = 0.5 * (index + jnp.sqrt(index**2 + 16.0))
        s = 2.0 / (w + jnp.sqrt(w**2 - 4.0))
        alpha = 1.0 - s**2
        return alpha, alpha**2 / (2.0 - alpha)


class Observed(eqx.Module):
    """Estimate of the observer."""

    momentum: Disturbance
    """y"""
    disturbance: Disturbance
    """d"""


def update(model: DisturbanceModel, tick, before: Observed, change, state) -> Observed:
    """The estimate a tick later.

    Args:
        model: effect and noise.
        tick: s.
        before: estimate of the last tick.
        change: (states,) predicted over the last tick from its estimate, with the disturbance.
        state: (states,) estimate of now.
    """
    alpha, beta = model.gains(tick)
    y = before.momentum + model.observed @ change
    innovation = model.observed @ state - y
    return Observed(y + alpha * innovation, before.disturbance + beta / tick * innovation)


def compensation(dynamics: Dynamics, model: DisturbanceModel, tracking: Tracking, state, control, time):
    """Cheapest change of (state, control), for each unit of disturbance, that balances it.

    A and B are the Jacobians of the dynamics. The change solves E E^+ (A dx + B du + E d) = 0 at the least tracking
    cost. A tilt and more thrust balance a wind. At little thrust, a tilt would have to be large: then a part is left.

    Args:
        dynamics: equations of motion.
        model: effect E.
        tracking: weights; of the state's error, and of the controls.
        state: (states,) of the reference.
        control: (controls,) of the reference.
        time: s.

    Returns:
        (states + controls, disturbances).

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> from jaxscp.control.disturbance import DisturbanceModel, compensation
        >>> force = DisturbanceModel([[0.0], [1.0]], noise=[0.01], drift=[1.0])
        >>> body, cost = jaxscp.DoubleIntegrator(1), jaxscp.control.Tracking.of(jaxscp.DoubleIntegrator(1))
        >>> (compensation(body, force, cost, jnp.zeros(2), jnp.zeros(1), 0.0) + 0.0).round(2).ravel().tolist()
        [0.0, 0.0, -1.0]
    """
    of_error = jax.jacfwd(tracking.error)(state, state)
    # changes of the state with a unit error each: of a quaternion, those that keep its norm
    of_unit = of_error.T @ jnp.linalg.inv(of_error @ of_error.T)
    of_state, of_control = jax.jacfwd(lambda x, u: dynamics(x, u, time), argnums=(0, 1))(state, control)
    balance = model.effect @ model.observed @ jnp.concatenate([of_state @ of_unit, of_control], axis=1)
    inverse_weights = 1.0 / jnp.concatenate([tracking.state, tracking.control])
    gram = (balance * inverse_weights) @ balance.T
    eye = jnp.eye(gram.shape[0], dtype=gram.dtype)
    change = -inverse_weights[:, None] * (balance.T @ jnp.linalg.solve(gram + SOFTNESS * eye, model.effect))
    errors = of_error.shape[0]
    return jnp.concatenate([of_unit @ change[:errors], change[errors:]])
