"""Sensors of a flight: pure functions of a key, the truth and the sensors' state."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Flag, Quaternion, Scalar, Vector3
from jaxscp.dynamics.rotations import conjugate, multiply, normalised, rotation_matrix
from jaxscp.simulation.scene import Scene

_DEGREE = math.pi / 180.0
State = Float[Array, "13"]


class IMU(eqx.Module):
    """Accelerations and body rates with white noise and a bias that is fixed for a flight; 200 Hz."""

    accelerometer_noise: Scalar = eqx.field(converter=as_floats, default=0.05)
    """Standard deviation of a sample, m/s^2."""
    gyroscope_noise: Scalar = eqx.field(converter=as_floats, default=0.005)
    """Standard deviation of a sample, rad/s."""
    accelerometer_bias: Scalar = eqx.field(converter=as_floats, default=0.05)
    """Standard deviation over flights, m/s^2."""
    gyroscope_bias: Scalar = eqx.field(converter=as_floats, default=0.005)
    """Standard deviation over flights, rad/s."""

    def init(self, key: PRNGKeyArray) -> Float[Array, "6"]:
        """Biases of a flight: acceleration m/s^2, rate rad/s."""
        return jax.random.normal(key, (6,)) * self._six(self.accelerometer_bias, self.gyroscope_bias)

    def measure(
        self, key: PRNGKeyArray, specific_force: Vector3, body_rate: Vector3, bias: Float[Array, "6"]
    ) -> Float[Array, "6"]:
        """Specific force in m/s^2 and body rate in rad/s, body axes."""
        noise = jax.random.normal(key, (6,)) * self._six(self.accelerometer_noise, self.gyroscope_noise)
        return jnp.concatenate([specific_force, body_rate]) + bias + noise

    @staticmethod
    def _six(first: Scalar, second: Scalar) -> Float[Array, "6"]:
        return jnp.concatenate([jnp.full(3, first), jnp.full(3, second)])


class OdometryState(eqx.Module):
    """Drift, and measurements on their way."""

    drift: Vector3
    """m, world axes."""
    last: Vector3
    """Position at the sample before, m."""
    waiting: Float[Array, "delay 10"]
    """Measurements, the oldest first."""


class Odometry(eqx.Module):
    """Position, velocity and attitude with white noise, a drift that grows with the distance, and a delay.

    The drift is a random walk over the distance: after ``drift_length`` metres each axis has the standard deviation
    ``drift * drift_length``.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> odometry, level = Odometry(), jnp.zeros(13).at[6].set(1.0)
        >>> state = odometry.init(level)
        >>> state, measured = odometry.measure(jax.random.key(0), level, state)
        >>> measured.shape
        (10,)
    """

    position_noise: Scalar = eqx.field(converter=as_floats, default=0.01)
    """m."""
    velocity_noise: Scalar = eqx.field(converter=as_floats, default=0.01)
    """m/s."""
    attitude_noise: Scalar = eqx.field(converter=as_floats, default=0.3 * _DEGREE)
    """rad."""
    drift: Scalar = eqx.field(converter=as_floats, default=0.005)
    """Drift in m for each metre, at ``drift_length``."""
    drift_length: Scalar = eqx.field(converter=as_floats, default=80.0)
    """m."""
    delay: int = eqx.field(static=True, default=2)
    """Samples: 20 ms at 100 Hz; one (100 ms at 10 Hz) for the carrier's own odometry."""

    def init(self, truth: State) -> OdometryState:
        """No drift; the pipeline is full of the first truth."""
        waiting = jnp.broadcast_to(truth[:10], (self.delay, 10))
        return OdometryState(jnp.zeros(3), truth[:3], waiting)

    def measure(
        self, key: PRNGKeyArray, truth: State, state: OdometryState
    ) -> tuple[OdometryState, Float[Array, "10"]]:
        """New state, and what arrives now: position m, velocity m/s, attitude, ``delay`` samples old."""
        walk, noise, turn = jax.random.split(key, 3)
        moved = jnp.sqrt(jnp.sum((truth[:3] - state.last) ** 2) + 1e-18)
        rate = self.drift * jnp.sqrt(self.drift_length)
        drift = state.drift + rate * jnp.sqrt(moved) * jax.random.normal(walk, (3,))
        white = jax.random.normal(noise, (6,))
        position = truth[:3] + drift + self.position_noise * white[:3]
        velocity = truth[3:6] + self.velocity_noise * white[3:]
        attitude = perturbed(truth[6:10], self.attitude_noise * jax.random.normal(turn, (3,)))
        line = jnp.concatenate([state.waiting, jnp.concatenate([position, velocity, attitude])[None]])
        return OdometryState(drift, truth[:3], line[1:]), line[0]


class DeckState(eqx.Module):
    """Bias of a flight, and measurements on their way."""

    bias: Float[Array, "6"]
    """m and rad."""
    waiting: Float[Array, "delay 8"]
    """Measurements, the oldest first."""


class DeckSensor(eqx.Module):
    """Pose of the deck relative to the vehicle, within a range; 30 Hz."""

    position_noise: Scalar = eqx.field(converter=as_floats, default=0.005)
    """m."""
    attitude_noise: Scalar = eqx.field(converter=as_floats, default=0.5 * _DEGREE)
    """rad."""
    position_bias: Scalar = eqx.field(converter=as_floats, default=0.002)
    """Standard deviation over flights, m."""
    attitude_bias: Scalar = eqx.field(converter=as_floats, default=0.2 * _DEGREE)
    """Standard deviation over flights, rad."""
    greatest_range: Scalar = eqx.field(converter=as_floats, default=2.0)
    """m."""
    delay: int = eqx.field(static=True, default=2)
    """Whole samples: 67 ms at 30 Hz, as 50 ms is no whole number of them."""

    def init(self, key: PRNGKeyArray) -> DeckState:
        """A bias, and an empty pipeline."""
        scale = jnp.concatenate([jnp.full(3, self.position_bias), jnp.full(3, self.attitude_bias)])
        return DeckState(scale * jax.random.normal(key, (6,)), jnp.zeros((self.delay, 8)).at[:, 3].set(1.0))

    def measure(
        self, key: PRNGKeyArray, vehicle: State, position: Vector3, attitude: Quaternion, state: DeckState
    ) -> tuple[DeckState, tuple[Vector3, Quaternion, Flag]]:
        """New state, and what arrives now: the deck in body axes (m), its relative attitude, and whether it is seen.

        Args:
            key: random key.
            vehicle: true state of the vehicle.
            position: true centre of the deck's surface, m.
            attitude: true attitude of the deck.
            state: bias and pipeline.
        """
        first, second = jax.random.split(key)
        relative = rotation_matrix(vehicle[6:10]).T @ (position - vehicle[:3])
        turn = multiply(conjugate(vehicle[6:10]), attitude)
        noisy = relative + state.bias[:3] + self.position_noise * jax.random.normal(first, (3,))
        angles = state.bias[3:] + self.attitude_noise * jax.random.normal(second, (3,))
        seen = jnp.sum(relative**2) < self.greatest_range**2
        sample = jnp.concatenate([noisy, perturbed(turn, angles), jnp.where(seen, 1.0, 0.0)[None]])
        line = jnp.concatenate([state.waiting, sample[None]])
        return DeckState(state.bias, line[1:]), (line[0, :3], line[0, 3:7], line[0, 7] > 0.5)


class LiDAR(eqx.Module):
    """Ranges along fixed directions of the body, by ray casting; 10 Hz."""

    directions: Float[Array, "rays 3"]
    """Unit vectors, body axes."""
    noise: Scalar = eqx.field(converter=as_floats, default=0.02)
    """m."""
    dropout: Scalar = eqx.field(converter=as_floats, default=0.02)
    """Probability that a return is lost."""
    leaves: Scalar = eqx.field(converter=as_floats, default=0.0)
    """Returns of leaves for each metre of a ray's way; some 0.002 outdoors."""
    greatest_range: Scalar = eqx.field(converter=as_floats, default=30.0)
    """m; no return beyond."""

    def ranges(self, key: PRNGKeyArray, vehicle: State, scene: Scene) -> Float[Array, "rays"]:
        """Distance along each direction, m; zero without a return.

        Args:
            key: random key.
            vehicle: true state of the vehicle.
            scene: obstacles.
        """
        noise, lost, leaf = jax.random.split(key, 3)
        rays = self.directions.shape[:1]
        turn = rotation_matrix(vehicle[6:10])
        ranges = scene.ranges(vehicle[:3], self.directions @ turn.T)
        foliage = jax.random.exponential(leaf, rays) / jnp.maximum(self.leaves, 1e-9)
        ranges = jnp.minimum(ranges, foliage)
        seen = (ranges < self.greatest_range) & (jax.random.uniform(lost, rays) > self.dropout)
        return jnp.where(seen, ranges + self.noise * jax.random.normal(noise, rays), 0.0)

    def scan(
        self, key: PRNGKeyArray, vehicle: State, scene: Scene
    ) -> tuple[Float[Array, "rays 3"], Float[Array, "rays"]]:
        """Points in body axes, m, and weights: one for a return, zero for none. Points without return are zero."""
        ranges = self.ranges(key, vehicle, scene)
        return ranges[:, None] * self.directions, jnp.where(ranges == 0.0, 0.0, 1.0)


def perturbed(q: Quaternion, angles: Vector3) -> Quaternion:
    """An attitude turned by small angles in rad about its own axes."""
    return normalised(multiply(q, jnp.concatenate([jnp.ones(1), 0.5 * angles])))
