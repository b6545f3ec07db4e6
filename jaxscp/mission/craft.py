"""The simulated vehicle as a mission may use it, and the truth as a record for the assessment."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from jaxscp.mission.cases import Case, sent_off
from jaxscp.mission.mapping import Points, in_odometry_frame
from jaxscp.mission.phases import Phase
from jaxscp.mission.pilot import Pilot, PilotState
from jaxscp.simulation import (
    Flight,
    LiDAR,
    Loop,
    Scene,
    Sensors,
    World,
    advance,
    begin,
    simulated_mav,
    vehicle_state,
)
from jaxscp.simulation.simulate import CONTROL
from jaxscp.simulation.vehicles import FEET_DEPTH

PERIODS = 50  # of 10 ms between two looks of the commander
CHUNK = CONTROL * PERIODS  # s


class Craft:
    """A vehicle in flight. Public methods give estimates and scans; the truth goes to ``record`` alone.

    Args:
        case: world and task.
        pilot: ``nominal_pilot()`` by default.
        sensors: by default ``Sensors()``.
    """

    def __init__(self, case: Case, pilot: Pilot | None = None, sensors: Sensors | None = None) -> None:
        self._case = case
        self.pilot = _placed(pilot or nominal_pilot())
        self._sensors = _placed(sensors or Sensors())
        self._world = _placed(case.world)
        self._loop = _placed(_begin(self._world, self._sensors, self.pilot, case.key))
        self._scans = 0
        self.record = Record()

    @property
    def memory(self) -> PilotState:
        """The pilot's memory."""
        return self._loop.controller

    @property
    def phase(self) -> Phase:
        """Present phase."""
        return Phase(int(self.memory.phase))

    @property
    def time(self) -> float:
        """s since the begin."""
        return float(self._loop.world.time)

    def state(self) -> Float[np.ndarray, "13"]:
        """Estimated state."""
        return np.asarray(self._loop.observation.state())

    def deck(self) -> Float[np.ndarray, "3"]:
        """Estimated centre of the deck's surface, m."""
        return np.asarray(self._loop.observation.deck.position)

    def scan(self) -> Points:
        """Points of one scan in the frame of the odometry, m."""
        key = jax.random.fold_in(jax.random.fold_in(self._case.key, 7), self._scans)
        self._scans += 1
        points, seen = _scan(self._case.lidar, key, vehicle_state(self._loop.world), self._case.scene)
        return in_odometry_frame(np.asarray(points), np.asarray(seen), self.state())

    def order(self, memory: PilotState) -> None:
        """Give the pilot a changed memory: a plan, a stop, or the order to land."""
        self._loop = eqx.tree_at(lambda loop: loop.controller, self._loop, _placed(memory))

    def call_carrier(self) -> None:
        """Tell the carrier that the landing begins: it may move from now on."""
        self._world = _placed(sent_off(self._world, self._loop.world.time))

    def advance(self) -> None:
        """Half a second of flight."""
        self._loop, flight = _advance(self._world, self._sensors, self.pilot, self._loop)
        distance = _distances(self._case.scene, flight.vehicle[:, :3])
        self.record.add(self.phase, jax.tree.map(np.asarray, flight), np.asarray(distance))


class Record:
    """True histories at 200 Hz, and the phases at the ends of the parts."""

    def __init__(self) -> None:
        self._parts: list[Flight] = []
        self._distances: list[np.ndarray] = []
        self.phases: list[Phase] = []

    def add(self, phase: Phase, flight: Flight, distance: np.ndarray) -> None:
        """Add a part."""
        self.phases.append(phase)
        self._parts.append(flight)
        self._distances.append(distance)

    def flight(self) -> Flight:
        """All parts in one."""
        return jax.tree.map(lambda *parts: np.concatenate(parts), *self._parts)

    def distance(self) -> Float[np.ndarray, "ticks"]:
        """Distance of the vehicle's centre from the obstacles, m."""
        return np.concatenate(self._distances)


def _placed(tree: Any) -> Any:
    """The same arrays on the first device and without weak types: other ones would compile another program."""
    device = jax.devices()[0]
    place = lambda x: jax.device_put(jnp.asarray(x, x.dtype), device)  # noqa: E731
    return jax.tree.map(lambda x: place(x) if isinstance(x, jax.Array) else x, tree)


def nominal_pilot() -> Pilot:
    """The pilot of the vehicle as it was designed; the true vehicle of a case differs."""
    return Pilot.of(simulated_mav())


@eqx.filter_jit
def _begin(world: World, sensors: Sensors, pilot: Pilot, key: PRNGKeyArray) -> Loop:
    deck = world.course.start.at[2].add(sensors.deck_filter.height + FEET_DEPTH)
    return begin(world, sensors, pilot.init(jnp.zeros(13).at[6].set(1.0).at[:3].set(deck)), key)


@eqx.filter_jit
def _advance(world: World, sensors: Sensors, pilot: Pilot, loop: Loop) -> tuple[Loop, Flight]:
    return advance(world, sensors, pilot, loop, PERIODS)


@eqx.filter_jit
def _scan(lidar: LiDAR, key: PRNGKeyArray, vehicle, scene: Scene):
    return lidar.scan(key, vehicle, scene)


@eqx.filter_jit
def _distances(scene: Scene, places):
    return jax.vmap(scene.distance)(places)
