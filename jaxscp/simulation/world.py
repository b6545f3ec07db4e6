"""The world: two bodies in contact, air, motors, and the carrier's own controller; one step of it."""

import contextlib
import io
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, PRNGKeyArray

with contextlib.redirect_stdout(io.StringIO()):  # it prints that it misses a package, which it can do without
    from mujoco import mjx

from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.airframes import Airframe, paper_carrier
from jaxscp.dynamics.rotations import rotation_matrix
from jaxscp.simulation import bodies
from jaxscp.simulation.aerodynamics import Aerodynamics, Deck
from jaxscp.simulation.course import Course
from jaxscp.simulation.geometric import Geometric
from jaxscp.simulation.gusts import Dryden, GustState
from jaxscp.simulation.motors import Motors, MotorState
from jaxscp.simulation.vehicles import FEET_DEPTH, simulated_mav

State = Float[Array, "13"]


class Motion(eqx.Module):
    """Vehicle and carrier in MuJoCo's coordinates. The rest of MuJoCo's data follows from them in each step."""

    qpos: Float[Array, "14"]
    """Position m and attitude of each."""
    qvel: Float[Array, "12"]
    """Velocity m/s and body rate rad/s of each."""
    qacc: Float[Array, "12"]
    """Last accelerations: where the search for contact forces begins."""


class WorldState(eqx.Module):
    """All that changes."""

    motion: Motion
    wrenches: Float[Array, "2 6"]
    """Force N and torque N m on vehicle and carrier in the last step, world axes."""
    motors: MotorState
    gust: GustState
    wind: Vector3
    """Wind with gusts, m/s."""
    integral: Vector3
    """Of the carrier's controller, m s."""
    deck: Deck
    time: Scalar
    """s."""


class World(eqx.Module):
    """All that stays the same over a flight. Build it with ``World.of``."""

    model: mjx.Model
    airframe: Airframe
    motors: Motors
    air: Aerodynamics
    gusts: Dryden
    carrier: Geometric
    course: Course
    """Reference of the carrier."""

    @staticmethod
    def of(
        *,
        airframe: Airframe | None = None,
        air: Aerodynamics | None = None,
        wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start: tuple[float, float, float] = (0.0, 0.0, 2.0),
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> "World":
        """The paper's vehicle and carrier, in air that moves at a mean wind in m/s.

        Args:
            airframe: the vehicle; ``simulated_mav()`` by default. Its inertia matrix must be diagonal.
            air: aerodynamic parameters.
            wind: mean wind, m/s.
            start: where the carrier begins, m.
            velocity: of the carrier, m/s.

        Raises:
            ValueError: if a known vector is not three finite numbers, the vehicle's gravity is not the world's, or its
                inertia matrix is not diagonal.
        """
        airframe, carrier = airframe or simulated_mav(), paper_carrier()
        for name, vector in (("wind", wind), ("start", start), ("velocity", velocity)):
            _check_vector(name, vector)
        _check_body(airframe)
        return World(
            mjx.put_model(bodies.model(airframe, carrier)),
            airframe,
            Motors(airframe.thrust_min, airframe.thrust_max),
            air or Aerodynamics(),
            Dryden(jnp.asarray(wind, float)),
            Geometric(carrier, attitude_gain=60.0, rate_gain=14.0),
            Course(start, velocity),
        )

    def init(self, key: PRNGKeyArray, height: Scalar | float = 0.0) -> WorldState:
        """The vehicle at a height in m over its place on the deck; both bodies at the carrier's velocity."""
        hover = self.carrier.airframe.body.hover_thrust().sum()
        start, velocity, _ = self.course.at(jnp.zeros(()))
        deck = Deck(start.at[2].add(bodies.DECK_HEIGHT), jnp.zeros(4).at[0].set(1.0), hover)
        level = jnp.array([1.0, 0.0, 0.0, 0.0])
        place = deck.position.at[2].add(FEET_DEPTH + height)
        qpos = jnp.concatenate([place, level, start, level])
        qvel = jnp.concatenate([velocity, jnp.zeros(3), velocity, jnp.zeros(3)])
        motion = Motion(qpos, qvel, jnp.zeros_like(qvel))
        gust, zero = self.gusts.init(key), jnp.zeros(3)
        return WorldState(
            motion, jnp.zeros((2, 6)), self.motors.init(), gust, self.gusts.wind, zero, deck, jnp.zeros(())
        )

    def step(self, state: WorldState, command: Float[Array, "rotors"], key: PRNGKeyArray) -> WorldState:
        """The state after one time step of constant commands in N."""
        dt = bodies.TIME_STEP
        motors = self.motors.step(state.motors, command, dt)
        gust, change = self.gusts.step(state.gust, dt, key)
        wind = self.gusts.wind + change
        place, velocity, yaw = self.course.at(state.time)
        pilot = eqx.tree_at(lambda c: c.yaw, self.carrier, yaw)
        integral, own = pilot(state.integral, carrier_state(state), place, velocity, dt)
        deck = deck_of(state, own.sum())
        vehicle = vehicle_state(state)
        force, torque = self.air.wrench(vehicle, motors.thrusts, wind, deck)
        rows = (
            _row(self.airframe, vehicle, motors.thrusts) + _in_world(vehicle, force, torque),
            _row(self.carrier.airframe, carrier_state(state), own),
        )
        wrenches = jnp.stack(rows)
        motion = self._moved(state.motion, wrenches)
        return WorldState(motion, wrenches, motors, gust, wind, integral, deck, state.time + dt)

    def _moved(self, motion: Motion, wrenches: Float[Array, "2 6"]) -> Motion:
        """The bodies after one time step under forces and torques in world axes, N and N m."""
        data = mjx.make_data(self.model)
        data = data.replace(
            qpos=motion.qpos,
            qvel=motion.qvel,
            qacc_warmstart=motion.qacc,
            xfrc_applied=data.xfrc_applied.at[jnp.array([bodies.VEHICLE, bodies.CARRIER])].set(wrenches),
        )
        with jax.numpy_dtype_promotion("standard"):  # MJX multiplies floats by flags
            data = mjx.step(self.model, data)
        return Motion(data.qpos, data.qvel, data.qacc_warmstart)


def vehicle_state(state: WorldState) -> State:
    """Position, velocity, attitude, body rate of the vehicle."""
    qpos, qvel = state.motion.qpos, state.motion.qvel
    return jnp.concatenate([qpos[:3], qvel[:3], qpos[3:7], qvel[3:6]])


def carrier_state(state: WorldState) -> State:
    """The same of the carrier."""
    qpos, qvel = state.motion.qpos, state.motion.qvel
    return jnp.concatenate([qpos[7:10], qvel[6:9], qpos[10:14], qvel[9:12]])


def deck_of(state: WorldState, thrust: Scalar) -> Deck:
    """The deck under a carrier with a total thrust in N."""
    carrier = carrier_state(state)
    up = rotation_matrix(carrier[6:10])[:, 2]
    return Deck(carrier[:3] + bodies.DECK_HEIGHT * up, carrier[6:10], thrust)


def _row(airframe: Airframe, state: State, thrusts: Float[Array, "rotors"]) -> Float[Array, "6"]:
    """Force and torque of rotors in world axes, as MuJoCo applies them."""
    body, turn = airframe.body, rotation_matrix(state[6:10])
    return _in_world(state, turn @ (body.thrust_map @ thrusts), body.torque_map @ thrusts)


def _in_world(state: State, force: Vector3, torque: Vector3) -> Float[Array, "6"]:
    """A force in world axes and a torque in body axes, both in world axes."""
    return jnp.concatenate([force, rotation_matrix(state[6:10]) @ torque])


def open_loop(world: World, state: WorldState, commands: Float[Array, "steps rotors"], key: PRNGKeyArray):
    """States at every step under given commands: the last world state, and (vehicle, carrier) histories."""

    def step(state, inputs):
        new = world.step(state, *inputs)
        return new, (vehicle_state(new), carrier_state(new))

    return jax.lax.scan(step, state, (commands, jax.random.split(key, commands.shape[0])))


def _check_vector(name: str, vector: Any) -> None:
    if isinstance(vector, Tracer):
        return
    parts = vector if isinstance(vector, list | tuple) else [vector]
    if any(isinstance(part, Tracer) for part in parts):
        return
    values = np.asarray(vector)
    if values.shape != (3,) or values.dtype.kind not in "fiu" or not np.all(np.isfinite(values)):
        raise ValueError(f"{name}: expected three finite numbers, got {vector!r}.")


def _check_body(airframe: Airframe) -> None:
    """What MuJoCo's model of the vehicle cannot hold."""
    body = airframe.body
    if not isinstance(body.gravity, Tracer) and not np.allclose(body.gravity, bodies.GRAVITY, atol=1e-6):
        raise ValueError(
            f"airframe.body.gravity: the world has {bodies.GRAVITY} m/s^2, but the vehicle {np.asarray(body.gravity)}."
        )
    if not isinstance(body.inertia, Tracer):
        inertia = np.asarray(body.inertia)
        if np.any(np.abs(inertia - np.diag(np.diag(inertia))) > 1e-9 * np.max(np.abs(inertia))):
            raise ValueError(
                "airframe.body.inertia: the world takes a diagonal matrix; turn the body's axes."
            )
