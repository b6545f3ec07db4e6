"""Units of a landing, taken from the landing itself (``sizes``): the solver works on numbers near one at every size.

The start is the origin, and the goal lies ahead of it. The units have no derivatives: an optimum does not depend on
them.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Quaternion, Scalar, Vector3
from jaxscp.dynamics import rotations
from jaxscp.landing.constraints import (
    inside_zone,
    within_body_rate,
    within_control_limits,
    within_speed,
    within_thrust_rate,
    within_tilt,
)
from jaxscp.landing.mission import BodyState, Ellipsoids, FlightLimits, Mission, Weights
from jaxscp.landing.sizes import sizes_of
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.trajectory import Trajectory

LEVEL = 1e-6  # of the route: horizontal distance of start and goal below which the start's heading counts


class Units(eqx.Module):
    """Size of one unit of the solver in the user's units, and the solver's frame."""

    origin: Vector3
    """m"""
    turn: Quaternion
    """From the user's world axes to the solver's, about the vertical."""
    length: Scalar
    """m"""
    time: Scalar
    """s"""
    mass: Scalar
    """kg"""
    cost: Scalar

    @property
    def speed(self) -> Scalar:
        """m/s"""
        return self.length / self.time

    @property
    def force(self) -> Scalar:
        """N"""
        return self.mass * self.speed / self.time

    @property
    def matrix(self) -> Float[Array, "3 3"]:
        """Rotation from the user's world axes to the solver's."""
        return rotations.rotation_matrix(self.turn)

    def trajectory(self, own: Trajectory) -> Trajectory:
        """A trajectory in the user's units, from one in the solver's."""
        back, matrix = rotations.conjugate(self.turn), self.matrix
        parts = [
            self.origin + self.length * own.state[:, :3] @ matrix,
            self.speed * own.state[:, 3:6] @ matrix,
            jax.vmap(lambda q: rotations.multiply(back, q))(own.state[:, 6:10]),
            own.state[:, 10:] / self.time,
        ]
        nodes = self.time * own.time, jnp.concatenate(parts, axis=1), self.force * own.control
        return Trajectory(*nodes, self.time * own.dilation, own.zero_order_hold)

    def own_trajectory(self, plan: Trajectory) -> Trajectory:
        """A trajectory in the solver's units, from one in the user's."""
        state = jax.vmap(self._state)(plan.state)
        return Trajectory(
            plan.time / self.time,
            state,
            plan.control / self.force,
            plan.dilation / self.time,
            plan.zero_order_hold,
        )

    def multipliers(self, problem: ScaledTimeProblem, own: Multipliers) -> Multipliers:
        """Multipliers in the user's units, from the multipliers in the solver's units.

        A multiplier is a derivative of the cost by a residual: its unit is the cost's over the residual's.
        """
        values = [
            self.cost * self._turned(c.function, y) / self._size(c.function)
            for c, y in zip(problem.constraints, own.values, strict=False)
        ]
        return Multipliers(
            self._of_states(own.flow),
            self._of_states(own.initial),
            self._of_states(own.final),
            (*values, self.cost * own.values[-1] / self.time),
        )

    def _of_states(self, y: Float[Array, "*b rows"]) -> Float[Array, "*b rows"]:
        """Multipliers of rows in the order of states, or of an end condition on a pose."""
        # Rows beyond the twelve of a pose: a fourth component of the quaternion is among them.
        whole = y.shape[-1] - 12
        turned = [y[..., :3] @ self.matrix, y[..., 3:6] @ self.matrix, y[..., 6:]]
        if whole > 0:
            back = _left_product(rotations.conjugate(self.turn))
            turned = [*turned[:2], y[..., 6:10] @ back.T, y[..., 10:]]
        one = jnp.ones_like(self.time)
        last = [one / self.time] * 3 + [self.time] * max(whole - 1, 0)
        sizes = [self.length] * 3 + [self.speed] * 3 + [one] * (3 + min(whole, 1)) + last
        return self.cost * jnp.concatenate(turned, axis=-1) / jnp.stack(sizes)

    def _size(self, function: Callable[..., Any]) -> Scalar | float:
        """Size of the values of a constraint."""
        return {
            within_control_limits: self.force,
            within_speed: self.speed,
            within_tilt: 1.0,
            within_body_rate: 1.0 / self.time,
            within_thrust_rate: self.time,
            inside_zone: 1.0,
        }.get(function, self.length)

    def _turned(self, function: Callable[..., Any], y: Float[Array, "*b rows"]) -> Float[Array, "*b rows"]:
        """Multipliers of a constraint with the rows that lie along world axes turned back."""
        if function is within_speed:
            return jnp.concatenate([y[..., :1], y[..., 1:] @ self.matrix], axis=-1)
        if function is within_tilt:
            c, s = self.turn[0], self.turn[3]
            return jnp.concatenate([y[..., :1], y[..., 1:] @ jnp.array([[c, -s], [s, c]])], axis=-1)
        return y

    def _state(self, state: Float[Array, "13"]) -> Float[Array, "13"]:
        return self._body_state(BodyState.of(state)).vector()

    def _position(self, points: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
        return (points - self.origin) @ self.matrix.T / self.length

    def _body_state(self, state: BodyState) -> BodyState:
        return BodyState(
            self._position(state.position),
            self.matrix @ state.velocity / self.speed,
            rotations.multiply(self.turn, state.attitude),
            state.body_rate * self.time,
        )

    def _ellipsoids(self, zones: Ellipsoids | None) -> Ellipsoids | None:
        if zones is None:
            return None
        return Ellipsoids(self._position(zones.centres), zones.shapes @ self.matrix.T * self.length)


def _left_product(a: Quaternion) -> Float[Array, "4 4"]:
    """The matrix of the Hamilton product from the left by a quaternion."""
    return jax.vmap(lambda b: rotations.multiply(a, b), out_axes=1)(jnp.eye(4, dtype=a.dtype))


def units_of(mission: Mission) -> Units:
    """Units of a mission, without derivatives; its own where it is not valid."""
    mission = jax.lax.stop_gradient(mission)
    sizes = sizes_of(mission)
    return Units(mission.start.position, _turn(mission), sizes.length, sizes.time, sizes.mass, sizes.cost)


def _turn(mission: Mission) -> Quaternion:
    """Rotation about the vertical that puts the goal ahead; none where components along world axes are free."""
    if mission.start_fixed is not None or mission.goal_fixed is not None:
        return jnp.eye(4, dtype=mission.start.position.dtype)[0]
    way = (mission.goal.position - mission.start.position)[:2]
    nose = rotations.rotation_matrix(mission.start.attitude)[:2, 0]
    upright = jnp.linalg.norm(way) <= LEVEL * jnp.linalg.norm(mission.goal.position - mission.start.position)
    way = jnp.where(upright, nose, way)
    return rotations.from_yaw(-jnp.arctan2(way[1], way[0]))


def in_units(mission, units: Units):
    """The same mission in other units, of the same class.

    Args:
        mission: in the user's units.
        units: of ``units_of``.
    """
    m, u = mission, units
    corridor, limits, airframe = m.corridor, m.limits, m.airframe
    offsets = (corridor.offsets - corridor.normals @ u.origin) / u.length
    unused = jnp.all(corridor.normals == 0.0, axis=-1)  # their offset is one at every size
    body = dataclasses.replace(
        airframe.body,
        mass=airframe.body.mass / u.mass,
        inertia=airframe.body.inertia / (u.mass * u.length**2),
        torque_map=airframe.body.torque_map / u.length,
        gravity=u.matrix @ airframe.body.gravity * u.time / u.speed,
    )
    sized = (limits.speed, u.speed), (limits.tilt, 1.0), (limits.body_rate, 1.0 / u.time)
    sized = *sized, (limits.thrust_rate, u.force / u.time)
    return dataclasses.replace(
        m,
        airframe=dataclasses.replace(
            airframe,
            body=body,
            thrust_min=airframe.thrust_min / u.force,
            thrust_max=airframe.thrust_max / u.force,
            radius=airframe.radius / u.length,
        ),
        start=u._body_state(m.start),
        goal=u._body_state(m.goal),
        corridor=dataclasses.replace(
            corridor,
            normals=corridor.normals @ u.matrix.T,
            offsets=jnp.where(unused, corridor.offsets, offsets),
            joints=u._position(corridor.joints),
        ),
        weights=Weights(m.weights.control * u.force * u.time / u.cost, m.weights.time * u.time / u.cost),
        dilation_min=m.dilation_min / u.time,
        dilation_max=m.dilation_max / u.time,
        limits=FlightLimits(*(None if limit is None else limit / size for limit, size in sized)),
        keep_out=u._ellipsoids(m.keep_out),
        gates=u._ellipsoids(m.gates),
        deck_velocity=None if m.deck_velocity is None else u.matrix @ m.deck_velocity / u.speed,
        recovery=m.recovery / u.length,
        near_obstacles=None,  # the certificate reads them, in the user's units
    )
