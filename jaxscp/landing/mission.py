"""The data of a landing: vehicle, ends, corridor, limits and weights. Every float is a leaf of the pytree.

Optional parts (limits, keep-out zones, gates, a moving deck, free components) are ``None`` by default, and then add no
work.
"""

import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscp.core.arrays import as_floats, floats, namespace, numbers, triple, unit_lengths
from jaxscp.core.obstacles import Hull, Obstacles
from jaxscp.core.types import Points, Quaternion, Scalar, Vector3
from jaxscp.corridor.polytopes import Corridor, unit_rows
from jaxscp.dynamics import rotations
from jaxscp.dynamics.airframes import Airframe
from jaxscp.dynamics.rigid_body import RigidBody
from jaxscp.landing.places import polytope_of
from jaxscp.landing.route import Route, route_of


class BodyState(eqx.Module):
    """Position, velocity, attitude and body rate of a vehicle."""

    position: Vector3 = eqx.field(converter=as_floats)
    """m, world."""
    velocity: Vector3 = eqx.field(converter=as_floats)
    """m/s, world."""
    attitude: Quaternion = eqx.field(converter=as_floats)
    """(w, x, y, z), body to world; scaled to unit norm where a problem is made of it."""
    body_rate: Vector3 = eqx.field(converter=as_floats)
    """rad/s, body."""

    @classmethod
    def of(cls, vector: Float[Array, "13"]) -> "BodyState":
        """From the 13 states in the order of ``Trajectory.state``.

        Raises:
            ValueError: the vector has another shape.

        Example:
            >>> import jax.numpy as jnp, jaxscp
            >>> state = jaxscp.at_rest([1.0, 2.0, 3.0])
            >>> bool((jaxscp.BodyState.of(state.vector()).position == jnp.array([1.0, 2.0, 3.0])).all())
            True
        """
        if (shape := np.shape(vector)) != (13,):
            raise ValueError(
                "BodyState.of: expected 13 numbers: position 3, velocity 3, attitude (w, x, y, z) and body rate 3; "
                f"got shape {shape}"
            )
        return cls(vector[:3], vector[3:6], vector[6:10], vector[10:])

    def vector(self) -> Float[Array, "13"]:
        """The 13 states in order."""
        return jnp.concatenate([self.position, self.velocity, self.attitude, self.body_rate])


def at_rest(position, yaw: Scalar | float = 0.0) -> BodyState:
    """Level and at rest at a position in m, heading ``yaw`` radians; warns of a yaw beyond a whole turn.

    Raises:
        ValueError: the position is no three numbers, or the yaw is no number.

    Example:
        >>> import jaxscp
        >>> jaxscp.at_rest([1.0, 2.0, 3.0]).vector().shape
        (13,)
    """
    zero, angle = floats(np.zeros(3)), numbers("yaw", yaw, "one number, in radians")
    if angle.shape != ():
        raise ValueError(f"yaw: expected one number, in radians, got shape {angle.shape}")
    if isinstance(angle, np.ndarray) and abs(angle) > 2.0 * np.pi:
        degrees = f"np.radians({float(angle):g})"
        warnings.warn(
            f"yaw: {angle:g} rad is beyond a whole turn; for degrees, write {degrees}", stacklevel=2
        )
    return BodyState(floats(triple("position", position)), zero, rotations.from_yaw(yaw), zero)


class Components(eqx.Module):
    """Which components of a ``BodyState`` are fixed: one where fixed, zero where free; (3,) each."""

    position: Vector3 = eqx.field(converter=as_floats)
    velocity: Vector3 = eqx.field(converter=as_floats)
    attitude: Vector3 = eqx.field(converter=as_floats)
    """By the three components of the rotation from the state asked for, in its own axes: roll, pitch, yaw."""
    body_rate: Vector3 = eqx.field(converter=as_floats)

    def vector(self) -> Float[Array, "12"]:
        """The 12 components in order."""
        return jnp.concatenate([self.position, self.velocity, self.attitude, self.body_rate])


def fixed(*, position=1.0, velocity=1.0, attitude=1.0, body_rate=1.0) -> Components:
    """Components that are fixed; each argument is a number for all three or three numbers.

    Raises:
        ValueError: an argument is neither.

    Example:
        >>> import jaxscp
        >>> jaxscp.fixed(attitude=[1, 1, 0]).attitude.tolist()  # any heading
        [1.0, 1.0, 0.0]
    """
    given = {"position": position, "velocity": velocity, "attitude": attitude, "body_rate": body_rate}
    three = {
        name: v if isinstance(v, list | tuple | str) or jnp.ndim(v) else [v, v, v]
        for name, v in given.items()
    }
    return Components(**{name: floats(triple(name, v)) for name, v in three.items()})


class Weights(eqx.Module):
    """Weights of the cost: control effort w_u and flight time w_t (equation 8, Table I)."""

    control: Scalar = eqx.field(converter=as_floats)
    time: Scalar = eqx.field(converter=as_floats)


class FlightLimits(eqx.Module):
    """Limits on the state of the flight and on the rotors' rates; None where there is none.

    Example:
        >>> import jaxscp
        >>> jaxscp.flight_limits(speed=4.0, tilt=0.6).body_rate is None
        True
    """

    speed: Scalar | None = eqx.field(default=None, converter=as_floats)
    """m/s"""
    tilt: Scalar | None = eqx.field(default=None, converter=as_floats)
    """rad, between the body's z axis and the vertical; below pi."""
    body_rate: Scalar | None = eqx.field(default=None, converter=as_floats)
    """rad/s, norm of the body rate."""
    thrust_rate: Scalar | None = eqx.field(default=None, converter=as_floats)
    """N/s, of every rotor."""


def _limits(given: FlightLimits | None) -> FlightLimits:
    return FlightLimits() if given is None else given


def flight_limits(*, speed=None, tilt=None, body_rate=None, thrust_rate=None) -> FlightLimits:
    """``FlightLimits`` from plain numbers.

    Raises:
        ValueError: a limit is no number; the message names it.
    """
    given = {"speed": speed, "tilt": tilt, "body_rate": body_rate, "thrust_rate": thrust_rate}
    found = {k: floats(numbers(f"limits.{k}", v, "a number")) for k, v in given.items() if v is not None}
    return FlightLimits(**found)


class Ellipsoids(eqx.Module):
    """Ellipsoids {p : |shape (p - centre)| <= 1}."""

    centres: Float[Array, "count 3"] = eqx.field(converter=as_floats)
    """m"""
    shapes: Float[Array, "count 3 3"] = eqx.field(converter=as_floats)
    """1/m; rows are the axes, each divided by its semi-axis."""


def ellipsoids(centres, semi_axes) -> Ellipsoids:
    """Ellipsoids with axes along the world's; balls if each has one semi-axis.

    As a zone or a gate, an ellipsoid bounds the vehicle's centre. For an obstacle, add the radius to its semi-axes.

    Args:
        centres: (count, 3) in m.
        semi_axes: (count, 3) or, for balls, (count,) or one number; in m.

    Returns:
        The ellipsoids; without centres none, which is no zone and no gate.

    Raises:
        ValueError: shapes contradict each other, or a semi-axis is negative.

    Example:
        >>> import jaxscp
        >>> jaxscp.ellipsoids([[0.0, 0.0, 1.0]], 0.5).shapes[0].diagonal().tolist()
        [2.0, 2.0, 2.0]
    """
    xp = namespace(centres, semi_axes)
    centres = xp.atleast_2d(numbers("ellipsoids: centres", centres))
    semi_axes = numbers("ellipsoids: semi_axes", semi_axes)
    if centres.size == 0:  # no ellipsoid: a list without entries has no shape of its own
        centres, semi_axes = centres.reshape(0, 3), xp.ones((0, 3))
    count = centres.shape[0]
    if centres.shape != (count, 3) or semi_axes.shape not in ((), (1,), (count,), (1, 3), (count, 3)):
        raise ValueError(
            "ellipsoids: expected centres of shape (count, 3), and semi-axes (count, 3), (count,) or one number; got "
            f"{centres.shape} and {semi_axes.shape}"
        )
    if xp is np and np.any(semi_axes < 0.0):
        raise ValueError(f"ellipsoids: a semi-axis must not be negative, got {semi_axes.min():g} m")
    if semi_axes.ndim < 2:
        semi_axes = xp.broadcast_to(semi_axes, centres.shape[:1])[:, None]
    semi_axes = xp.broadcast_to(semi_axes, centres.shape)
    with np.errstate(divide="ignore"):  # ``validate`` names the wrong field
        shapes = np.eye(3) / semi_axes[:, None, :]
    return Ellipsoids(jnp.asarray(centres), jnp.asarray(shapes))


PARTS = Airframe, RigidBody, BodyState, Components, Corridor, Ellipsoids, FlightLimits, Obstacles, Weights
"""Classes of a mission's fields: files name them."""


class Mission(eqx.Module):
    """The data of a landing; ``LandingScenario`` is the same with a planner's interface."""

    airframe: Airframe
    start: BodyState
    goal: BodyState
    """On the deck. For a moving deck: its position at time zero (of a re-plan: now), and the velocity relative to the
    deck. The landing cone stands on the goal's own x-y plane, so that a tilted goal is a tilted deck."""
    corridor: Corridor
    cone_angle: Scalar = eqx.field(converter=as_floats)
    """gamma_c in radians: angle of the landing cone's side above the deck; pi/4 in the paper."""
    weights: Weights
    dilation_min: Scalar = eqx.field(converter=as_floats)
    """Least dt/dtau in s: bounds the flight time and every part of the mesh."""
    dilation_max: Scalar = eqx.field(converter=as_floats)
    """Greatest dt/dtau in s."""
    obstacles: Points | None = eqx.field(default=None, converter=as_floats)
    """Point cloud in m, for pictures alone."""
    limits: FlightLimits = eqx.field(default=FlightLimits(), converter=_limits)
    """None: no limits."""
    keep_out: Ellipsoids | None = None
    """Zones that the centre stays out of: add the vehicle's radius."""
    gates: Ellipsoids | None = None
    """Zones to pass through, in this order, each at a time of the planner's choice: way-points and gates."""
    deck_velocity: Vector3 | None = eqx.field(default=None, converter=as_floats)
    """m/s, world: goal and landing cone move with it from time zero on. None for a deck at rest."""
    start_fixed: Components | None = None
    """None: all."""
    goal_fixed: Components | None = None
    """None: all."""
    recovery: Scalar = eqx.field(default=0.0, converter=as_floats)
    """m by which the start may lie outside of a wall or a zone. Above zero, it may also exceed a limit by a tenth. The
    first four intervals lead back inside. A re-plan takes 0.1 m, for measured starts."""
    near_obstacles: Obstacles | None = None
    """Obstacle points that the certificate measures the hull's clearance to: ``build_corridor`` and
    ``corridor.obstacles_near`` make them. None: no points are known."""

    def hull(self, context: Int[Array, "intervals"]) -> Hull | None:
        """The vehicle among the known obstacles; None where no points are known.

        Args:
            context: place of every interval (``landing.places``).
        """
        if self.near_obstacles is None:
            return None
        every = jnp.arange(self.corridor.count)
        ends = [self.corridor.same(every, every[k]) for k in (0, -1)]
        return Hull(self.airframe.radius, self.near_obstacles, (ends[0] | ends[1])[polytope_of(context)])

    def with_unit_directions(self) -> "Mission":
        """The same mission with unit normals of the corridor and unit quaternions of both ends.

        Offsets and violations are then metres, and the certificate starts from an attitude. Constructors cannot do
        this: a study replaces arrays inside a scenario. Therefore every function that reads directions calls this
        first. Unit vectors keep their bits.

        Example:
            >>> import equinox as eqx, jax.numpy as jnp, jaxscp
            >>> scenario = jaxscp.scenarios.platform_to_platform()
            >>> long = eqx.tree_at(lambda s: s.start.attitude, scenario, jnp.array([1.0009, 0.0, 0.0, 0.0]))
            >>> long.with_unit_directions().start.attitude.tolist()
            [1.0, 0.0, 0.0, 0.0]
        """
        rows = unit_rows(self.corridor.normals, self.corridor.offsets)
        attitudes = [end.attitude / unit_lengths(end.attitude) for end in (self.start, self.goal)]
        found = jnp if isinstance(self.corridor.normals, jax.Array) else np  # validation is of NumPy's arrays
        return eqx.tree_at(
            lambda s: (s.corridor.normals, s.corridor.offsets, s.start.attitude, s.goal.attitude),
            self,
            [found.asarray(v) for v in (*rows, *attitudes)],
        )

    def route(self) -> Route:
        """The way from start to goal over joints and gates; the corridor's normals have length one."""
        gates = None if self.gates is None else self.gates.centres
        return route_of(self.corridor, self.start.position, self.goal.position, gates)

    def goal_at(self, time: Scalar) -> BodyState:
        """The goal in the world at a time in s."""
        if self.deck_velocity is None:
            return self.goal
        here, velocity = (
            self.goal.position + self.deck_velocity * time,
            self.goal.velocity + self.deck_velocity,
        )
        return BodyState(here, velocity, self.goal.attitude, self.goal.body_rate)
