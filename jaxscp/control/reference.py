"""The reference of a controller: a plan sampled at equal steps of time.

A time-adaptive plan is integrated between its nodes once, when it is sampled. A tick then only interpolates.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Scalar
from jaxscp.problem.trajectory import Trajectory

SAMPLES = 500  # steps of 20 ms for 10 s: an acceleration of 10 m/s^2 then errs by 0.5 mm between samples


class Reference(eqx.Module):
    """States and controls at equal steps of time; held before the first and after the last.

    Example:
        >>> import jaxscp
        >>> from jaxscp.control import Reference
        >>> drive = jaxscp.Trajectory.from_arrays([0.0, 2.0], [[0.0, 0.0], [2.0, 2.0]], [[1.0], [1.0]])
        >>> reference = Reference.of(drive.with_dynamics(jaxscp.DoubleIntegrator(1)), start=10.0)
        >>> state, control = reference.at([11.0, 20.0])
        >>> state.round(4).tolist()
        [[0.5, 1.0], [2.0, 2.0]]
    """

    start: Scalar
    """s, time of the first sample."""
    step: Scalar
    """s, between samples."""
    state: Float[Array, "samples states"]
    control: Float[Array, "samples controls"]
    compensation: Float[Array, "samples variables disturbances"]
    """Change of (state, control) for each unit of disturbance, see ``disturbance.compensation``."""

    @staticmethod
    def of(
        trajectory: Trajectory, start: Scalar | float = 0.0, final_control=None, samples: int = SAMPLES
    ) -> "Reference":
        """Samples of a trajectory, for example ``solution.trajectory``.

        Args:
            trajectory: a plan with dynamics.
            start: s, the controller's time at which the plan begins.
            final_control: (controls,) controls after the end of the plan; of a landing, hover or the least thrust.
                By default the last node's controls.
            samples: number of samples, at equal steps from the start to the end.

        Raises:
            ValueError: if the trajectory has no dynamics, or is a batch.
        """
        found = trajectory.at(jnp.linspace(0.0, 1.0, samples) * trajectory.time[-1])
        last = trajectory.control[-1] if final_control is None else jnp.asarray(final_control)
        # one more sample, the end: it holds after the plan
        state = jnp.concatenate([found.state, found.state[-1:]])
        control = jnp.concatenate([found.control, last[None]])
        step = trajectory.time[-1] / (samples - 1)
        return Reference(
            jnp.asarray(start, state.dtype), step, state, control, _no_compensation(state, control)
        )

    @staticmethod
    def hold(state, control) -> "Reference":
        """A state and controls that do not change.

        Args:
            state: (states,); of a vehicle at rest, ``jaxscp.at_rest(position).vector()``.
            control: (controls,) that keep it there, ``body.hover_thrust()``.
        """
        states, controls = (jnp.stack([v, v]) for v in (jnp.asarray(state), jnp.asarray(control)))
        return Reference(jnp.zeros(()), jnp.ones(()), states, controls, _no_compensation(states, controls))

    def at(self, times) -> tuple[Float[Array, "*times states"], Float[Array, "*times controls"]]:
        """States and controls at times, linear between samples.

        Args:
            times: s, one or an axis of them.
        """
        i, fraction = self._position(times)
        return _between(self.state, i, fraction), _between(self.control, i, fraction)

    def compensated(self, times: Float[Array, "times"], disturbance: Float[Array, "disturbances"]):
        """The same under a disturbance: with the states and controls that meet it."""
        i, fraction = self._position(times)
        change = _between(self.compensation, i, fraction) @ disturbance
        state, control = _between(self.state, i, fraction), _between(self.control, i, fraction)
        return state + change[:, : state.shape[1]], control + change[:, state.shape[1] :]

    def _position(self, times):
        """The sample before each time, and the fraction of the step since."""
        last = self.state.shape[0] - 1
        position = jnp.clip((jnp.asarray(times) - self.start) / self.step, 0.0, last)
        i = jnp.clip(jnp.floor(jax.lax.stop_gradient(position)).astype(int), 0, last - 1)
        return i, position - i.astype(position.dtype)


def _between(values: Array, i: Array, fraction: Array) -> Array:
    fraction = fraction.reshape(fraction.shape + (1,) * (values.ndim - 1))
    return values[i] + fraction * (values[i + 1] - values[i])


def _no_compensation(state: Array, control: Array) -> Float[Array, "samples variables 0"]:
    return jnp.zeros((state.shape[0], state.shape[1] + control.shape[1], 0))
