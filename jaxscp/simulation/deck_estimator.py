"""A Kalman filter of the deck, in the frame of the vehicle's own odometry."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Flag, Quaternion, Scalar, Vector3
from jaxscp.dynamics.rotations import multiply, rotation_matrix

Pose = Float[Array, "7"]


class DeckEstimate(eqx.Module):
    """Position and velocity of the deck's surface, their covariance, and past poses for delayed sights."""

    mean: Float[Array, "2 3"]
    """Centre of the deck's surface in m, and its velocity in m/s; world axes of the vehicle's odometry."""
    covariance: Float[Array, "2 2"]
    """Of the errors of position and velocity, the same for each axis."""
    attitude: Quaternion
    """Last attitude that the carrier sent or that was seen."""
    unseen: Scalar
    """s since the deck was seen."""
    past: Float[Array, "poses 7"]
    """Poses of the vehicle as estimated, the oldest first, the last of now."""

    @property
    def position(self) -> Vector3:
        """Centre of the deck's surface, m."""
        return self.mean[0]

    @property
    def velocity(self) -> Vector3:
        """m/s."""
        return self.mean[1]

    @property
    def deviation(self) -> Scalar:
        """Standard deviation of the position on each axis, m."""
        return jnp.sqrt(self.covariance[0, 0])


class DeckFilter(eqx.Module):
    """Kalman filter of a deck whose acceleration is white noise, from two delayed sources.

    The deck sensor gives the deck in body axes. The carrier sends its own odometry, whose frame has a drift of its own
    against the vehicle's: its velocity always counts, its position only while the deck is not seen. Each measurement is
    compared with the estimate of its own time.

    Example:
        >>> import jax.numpy as jnp
        >>> filter_, level = DeckFilter(), jnp.zeros(13).at[6].set(1.0)
        >>> deck = filter_.predict(filter_.init(level, jnp.array([0.0, 0.0, -0.1])), level, 0.01)
        >>> seen = filter_.see(deck, jnp.array([0.0, 0.0, -0.2]), level[6:10], jnp.array(True))
        >>> bool(seen.position[2] < -0.1), float(seen.unseen)
        (True, 0.0)
    """

    acceleration: Scalar = eqx.field(converter=as_floats, default=0.3)
    """Root of the density of the deck's acceleration, m/s^2/Hz^(1/2)."""
    drift: Scalar = eqx.field(converter=as_floats, default=0.045)
    """Random walk of the odometry after a metre, on each axis, m."""
    relative_noise: Scalar = eqx.field(converter=as_floats, default=0.006)
    """Standard deviation of the deck sensor, m."""
    attitude_noise: Scalar = eqx.field(converter=as_floats, default=0.008)
    """Standard deviation of the attitude that turns it into world axes, rad."""
    position_noise: Scalar = eqx.field(converter=as_floats, default=0.02)
    """Standard deviation of the carrier's position, drift left out, m."""
    velocity_noise: Scalar = eqx.field(converter=as_floats, default=0.015)
    """Standard deviation of the carrier's velocity, m/s."""
    patience: Scalar = eqx.field(converter=as_floats, default=0.5)
    """s without sight after which the carrier's position counts."""
    height: Scalar = eqx.field(converter=as_floats, default=0.16)
    """Height of the deck's surface over the carrier's centre of mass, m."""
    delay: int = eqx.field(static=True, default=6)
    """Predictions between a sight and its arrival: 60 ms at 100 Hz."""
    message_delay: float = eqx.field(static=True, default=0.1)
    """s between a sample of the carrier's odometry and its arrival."""

    def init(self, vehicle: Float[Array, "13"], position: Vector3) -> DeckEstimate:
        """An estimate at a known place at rest.

        Args:
            vehicle: estimated state.
            position: centre of the deck's surface, m.
        """
        mean = jnp.stack([position, jnp.zeros(3)])
        past = jnp.broadcast_to(_pose(vehicle), (self.delay + 1, 7))
        level = jnp.zeros(4).at[0].set(1.0)
        return DeckEstimate(mean, jnp.diag(jnp.array([1e-4, 1e-4])), level, jnp.zeros(()), past)

    def predict(self, deck: DeckEstimate, vehicle: Float[Array, "13"], dt: float) -> DeckEstimate:
        """The estimate after dt seconds; the vehicle's estimated state joins the past."""
        step = jnp.array([[1.0, dt], [0.0, 1.0]])
        noise = self.acceleration**2 * jnp.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        way = jnp.sqrt(vehicle[3:6] @ vehicle[3:6] + 1e-12) * dt
        noise = noise.at[0, 0].add(self.drift**2 * way)  # the frame walks with the vehicle's odometry
        past = jnp.concatenate([deck.past, _pose(vehicle)[None]])[1:]
        covariance = step @ deck.covariance @ step.T + noise
        return DeckEstimate(step @ deck.mean, covariance, deck.attitude, deck.unseen + dt, past)

    def see(self, deck: DeckEstimate, relative: Vector3, attitude: Quaternion, seen: Flag) -> DeckEstimate:
        """The estimate after a sight, ``delay`` predictions old.

        Args:
            deck: the estimate.
            relative: centre of the deck's surface in body axes, m.
            attitude: the deck's relative to the vehicle.
            seen: whether there was a sight.
        """
        pose = deck.past[0]
        found = pose[:3] + rotation_matrix(pose[3:]) @ relative
        age = 0.01 * self.delay
        deviation2 = self.relative_noise**2 + self.attitude_noise**2 * (relative @ relative)
        row = jnp.array([1.0, -age])
        mean, covariance = _update(deck.mean, deck.covariance, row, found, deviation2)
        new = DeckEstimate(mean, covariance, multiply(pose[3:], attitude), jnp.zeros(()), deck.past)
        return _choose(seen, new, deck)

    def hear(self, deck: DeckEstimate, message: Float[Array, "10"]) -> DeckEstimate:
        """The estimate after a message: the carrier's position m, velocity m/s and attitude, in its own frame."""
        place = message[:3] + self.height * rotation_matrix(message[6:])[:, 2]
        velocity = jnp.array([0.0, 1.0])
        mean, covariance = _update(deck.mean, deck.covariance, velocity, message[3:6], self.velocity_noise**2)
        heard = DeckEstimate(mean, covariance, deck.attitude, deck.unseen, deck.past)
        row = jnp.array([1.0, -self.message_delay])
        mean, covariance = _update(mean, covariance, row, place, self.position_noise**2)
        # the drift of both frames is no white noise: the position never becomes as sure as its samples
        covariance = covariance.at[0, 0].add(self.drift**2)
        far = DeckEstimate(mean, covariance, message[6:], deck.unseen, deck.past)
        return _choose(deck.unseen > self.patience, far, heard)


def _pose(vehicle: Float[Array, "13"]) -> Pose:
    return jnp.concatenate([vehicle[:3], vehicle[6:10]])


def _update(mean, covariance, row: Float[Array, "2"], measured: Vector3, variance: Scalar):
    """A scalar Kalman update, the same for each axis."""
    gain = covariance @ row / (row @ covariance @ row + variance)
    left = jnp.eye(2) - jnp.outer(gain, row)
    joseph = left @ covariance @ left.T + variance * jnp.outer(gain, gain)
    return mean + gain[:, None] * (measured - row @ mean), joseph


def _choose(first: Flag, a: DeckEstimate, b: DeckEstimate) -> DeckEstimate:
    pick = lambda x, y: jnp.where(first, x, y)  # noqa: E731
    return DeckEstimate(
        pick(a.mean, b.mean),
        pick(a.covariance, b.covariance),
        pick(a.attitude, b.attitude),
        pick(a.unseen, b.unseen),
        a.past,
    )
