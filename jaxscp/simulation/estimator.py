"""An error-state Kalman filter: inertial samples predict, delayed odometry corrects."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.rotations import attitude_error, multiply, normalised, rotation_matrix
from jaxscp.simulation.sensors import IMU, Odometry

Covariance = Float[Array, "15 15"]
Nominal = Float[Array, "16"]


class Estimate(eqx.Module):
    """Nominal state, covariance of its error, and past nominal states for delayed measurements."""

    nominal: Nominal
    """Position m, velocity m/s, attitude, bias of acceleration m/s^2, bias of rate rad/s."""
    covariance: Covariance
    """Of the errors: position, velocity, attitude (rad, body axes), both biases."""
    past: Float[Array, "delay 16"]
    """Nominal states, the oldest first."""
    rate: Vector3
    """Last body rate without bias, rad/s."""

    def state(self) -> Float[Array, "13"]:
        """State (13,) for a controller: position m, velocity m/s, attitude, body rate rad/s."""
        return jnp.concatenate([self.nominal[:10], self.rate])


class ErrorStateFilter(eqx.Module):
    """Error-state Kalman filter of inertial samples and delayed odometry.

    Source: Sola, "Quaternion kinematics for the error-state Kalman filter", 2017, sections 5 and 6. Errors of attitude
    are small rotations in body axes.

    A measurement that is ``delay`` predictions old is compared with the nominal state of its own time. The difference
    corrects the present state and the past ones alike. The gain uses the present covariance, as if that had not changed
    over the delay: the estimated covariance is some percent too small. Position and attitude follow the odometry, whose
    drift cannot be observed without the deck.

    Example:
        >>> import jax.numpy as jnp
        >>> filter_, level = ErrorStateFilter(), jnp.zeros(13).at[6].set(1.0)
        >>> estimate = filter_.predict(filter_.init(level), jnp.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0]), 0.005)
        >>> bool(jnp.abs(estimate.state() - level).max() < 1e-12)
        True
    """

    imu: IMU = eqx.field(default_factory=IMU)
    """Model of the inertial unit: its noise, and the scatter of its biases over flights."""
    odometry: Odometry = eqx.field(default_factory=Odometry)
    """Model of the odometry: its noise."""
    gravity: Vector3 = eqx.field(converter=as_floats, default=(0.0, 0.0, -9.81))
    """m/s^2."""
    delay: int = eqx.field(static=True, default=4)
    """Predictions between a measurement and its arrival: 20 ms at 200 Hz."""

    def init(self, state: Float[Array, "13"]) -> Estimate:
        """An estimate at a known state with unknown biases; the state is as uncertain as one odometry sample."""
        nominal = jnp.concatenate([state[:10], jnp.zeros(6)])
        deviations = *self._odometry_noise(), self.imu.accelerometer_bias, self.imu.gyroscope_bias
        past = jnp.broadcast_to(nominal, (self.delay, 16))
        return Estimate(nominal, jnp.diag(_blocks(*deviations) ** 2), past, state[10:13])

    def predict(self, estimate: Estimate, imu: Float[Array, "6"], dt: float) -> Estimate:
        """The estimate after dt seconds of an inertial sample: specific force m/s^2, body rate rad/s."""
        x, turn = estimate.nominal, rotation_matrix(estimate.nominal[6:10])
        force, rate = imu[:3] - x[10:13], imu[3:] - x[13:]
        acceleration = turn @ force + self.gravity
        nominal = jnp.concatenate(
            [
                x[:3] + dt * x[3:6] + 0.5 * dt**2 * acceleration,
                x[3:6] + dt * acceleration,
                _turned(x[6:10], dt * rate),
                x[10:],
            ]
        )
        step = self._transition(turn, force, rate, dt)
        zero = jnp.zeros(())
        noise = _blocks(zero, dt * self.imu.accelerometer_noise, dt * self.imu.gyroscope_noise, zero, zero)
        covariance = step @ estimate.covariance @ step.T + jnp.diag(noise**2)
        past = jnp.concatenate([estimate.past, x[None]])[1:]
        return Estimate(nominal, covariance, past, rate)

    def correct(self, estimate: Estimate, odometry: Float[Array, "10"]) -> Estimate:
        """The estimate after a measurement of position m, velocity m/s and attitude, ``delay`` predictions old."""
        old = estimate.past[0]
        innovation = jnp.concatenate(
            [odometry[:6] - old[:6], 2.0 * attitude_error(odometry[6:10], old[6:10])]
        )
        noise = jnp.diag(_blocks(*self._odometry_noise()) ** 2)
        covariance = estimate.covariance
        gain = jnp.linalg.solve(covariance[:9, :9] + noise, covariance[:9]).T
        left = jnp.eye(15).at[:, :9].add(-gain)
        error = gain @ innovation
        return Estimate(
            _corrected(estimate.nominal, error),
            left @ covariance @ left.T + gain @ noise @ gain.T,  # Joseph's form stays positive
            jnp.stack([_corrected(x, error) for x in estimate.past]),
            estimate.rate - error[12:],
        )

    def _odometry_noise(self) -> tuple[Scalar, Scalar, Scalar]:
        return self.odometry.position_noise, self.odometry.velocity_noise, self.odometry.attitude_noise

    @staticmethod
    def _transition(turn: Float[Array, "3 3"], force: Vector3, rate: Vector3, dt: float) -> Covariance:
        """Derivative of the predicted error by the error, to first order in dt."""
        eye, step = jnp.eye(3), jnp.eye(15)
        step = step.at[:3, 3:6].set(dt * eye)
        step = step.at[3:6, 6:9].set(-dt * turn @ _cross(force))
        step = step.at[3:6, 9:12].set(-dt * turn)
        step = step.at[6:9, 6:9].set(eye - dt * _cross(rate))
        return step.at[6:9, 12:].set(-dt * eye)


def nominal_error(
    estimate: Estimate, truth: Float[Array, "13"], bias: Float[Array, "6"]
) -> Float[Array, "15"]:
    """Truth minus estimate, in the coordinates of the covariance."""
    x = estimate.nominal
    turn = 2.0 * attitude_error(truth[6:10], x[6:10])
    return jnp.concatenate([truth[:6] - x[:6], turn, bias - x[10:]])


def _corrected(x: Nominal, error: Float[Array, "15"]) -> Nominal:
    return jnp.concatenate([x[:6] + error[:6], _turned(x[6:10], error[6:9]), x[10:] + error[9:]])


def _turned(q: Float[Array, "4"], angles: Vector3) -> Float[Array, "4"]:
    """An attitude after a rotation vector in body axes, to third order in its length."""
    square = angles @ angles
    return normalised(
        multiply(q, jnp.concatenate([1.0 - square[None] / 8.0, (0.5 - square / 48.0) * angles]))
    )


def _cross(v: Vector3) -> Float[Array, "3 3"]:
    return jnp.cross(v, jnp.eye(3), axisa=0, axisb=0, axisc=0)


def _blocks(*values: Scalar) -> Float[Array, "rows"]:
    """Each value three times."""
    return jnp.repeat(jnp.stack(values), 3)
