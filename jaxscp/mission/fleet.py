"""The physics of many flights as one batch on a device. Flights begin and end in slots, each at its own time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from jaxscp.control import Reference
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Flag
from jaxscp.mission.cases import Case, sent_off
from jaxscp.mission.member import LOOK, Order, Row
from jaxscp.mission.phases import Phase
from jaxscp.mission.pilot import Pilot, PilotState
from jaxscp.simulation import Flight, LiDAR, Loop, Scene, Sensors, World, advance, begin, vehicle_state
from jaxscp.simulation.simulate import CONTROL
from jaxscp.simulation.vehicles import FEET_DEPTH

PERIODS = round(LOOK / CONTROL)
"""Of the controller, between two looks of the commander."""
GROUP = 64  # slots that are scanned, ordered or begun together: it bounds the memory of their rays and plans
_SCANS = 7  # number of the key of scans


class Start(NamedTuple):
    """The part of a case that a fleet needs, as arrays of the host."""

    world: World
    scene: Scene
    key: np.ndarray
    """Data of the key."""
    lidar: LiDAR

    @staticmethod
    def of(case: Case) -> "Start":
        """Of a case."""
        parts = case.world, case.scene, jax.random.key_data(case.key), case.lidar
        return Start(*jax.tree.map(lambda x: np.asarray(x) if eqx.is_array(x) else x, parts))


class Fleet:
    """Slots for flights in one kind of field: all of them advance together.

    Args:
        slots: flights at a time.
        pilot: of every flight.
        sensors: by default ``Sensors()``.
    """

    def __init__(self, slots: int, pilot: Pilot, sensors: Sensors | None = None) -> None:
        self.slots, self._group = slots, min(slots, GROUP)
        self._pilot, self._sensors = _on_device(pilot), _on_device(sensors or Sensors())
        self._lidar: LiDAR | None = None
        self._flights: Any = None
        self._scans = np.zeros(slots, int)

    def begin(self, starts: Mapping[int, Start]) -> None:
        """Begin flights in slots, instead of those that are there. All flights have the field of the first."""
        for chosen in _groups(sorted(starts), self._group):
            group = [starts[slot] for slot in chosen]
            self._lidar = self._lidar or _on_device(group[0].lidar)
            new = _begun(self._sensors, self._pilot, _stacked([start[:3] for start in group]))
            if self._flights is None:  # all slots are alike at first
                self._flights = _repeated(new, self.slots)
            self._flights = _placed(jnp.asarray(chosen), self._flights, new)
            self._scans[chosen] = 0

    def advance(self, active: Sequence[int]) -> dict[int, Row]:
        """Half a second of the active flights, and what became of them; the others wait."""
        assert self._flights is not None, "no flight has begun"
        moving = jnp.asarray(np.isin(np.arange(self.slots), active))
        self._flights, seen = _advanced((self._sensors, self._pilot), self._flights, moving)
        host = jax.tree.map(np.asarray, seen)
        scanning = [slot for slot in active if host.phase[slot] in (Phase.hover, Phase.cruise)]
        ranges = self._scanned(scanning)
        return {slot: _row(host, slot, ranges.get(slot)) for slot in active}

    def _scanned(self, slots: Sequence[int]) -> dict[int, Float[np.ndarray, "rays"]]:
        assert self._lidar is not None, "no flight has begun"
        found = {}
        for chosen in _groups(slots, self._group):
            numbers = jnp.asarray(chosen), jnp.asarray(self._scans[chosen])
            ranges = np.asarray(_ranges(self._lidar, self._flights, *numbers))
            found |= dict(zip(chosen, ranges, strict=True))
        self._scans[list(slots)] += 1
        return found

    def order(self, orders: Mapping[int, Order]) -> None:
        """Give pilots their orders."""
        for phase in (Phase.cruise, Phase.hover, Phase.approach):
            slots = [slot for slot, order in orders.items() if order.phase == phase]
            for chosen in _groups(slots, self._group):
                given = _stacked([orders[slot][1:] for slot in chosen])
                self._flights = _ordered((self._pilot, jnp.asarray(chosen), given), self._flights)


class Flights(eqx.Module):
    """Flights at a moment, an axis of slots in front."""

    world: World
    scene: Scene
    key: Key[Array, "*slots"]
    loop: Loop


class Seen(eqx.Module):
    """Half a second of flights: history, distance from the obstacles in m, and the knowledge of the pilots."""

    flight: Flight
    distance: Float[Array, "*slots ticks"]
    phase: Int[Array, "*slots"]
    attempts: Int[Array, "*slots"]
    time: Float[Array, "*slots"]
    state: Float[Array, "*slots 13"]
    deck: Float[Array, "*slots 3"]


def _row(seen: Seen, slot: int, ranges: Any) -> Row:
    own = jax.tree.map(lambda x: x[slot], seen)
    return Row(own.flight, own.distance, own.phase, own.attempts, own.time, own.state, own.deck, ranges)


@eqx.filter_jit
def _begun(sensors: Sensors, pilot: Pilot, starts: tuple[World, Scene, Array]) -> Flights:
    def one(world: World, scene: Scene, data: Array) -> Flights:
        key = jax.random.wrap_key_data(data)
        deck = world.course.start.at[2].add(sensors.deck_filter.height + FEET_DEPTH)
        first = pilot.init(jnp.zeros(13).at[6].set(1.0).at[:3].set(deck))
        return Flights(world, scene, key, begin(world, sensors, first, key))

    return eqx.filter_vmap(one)(*starts)


@eqx.filter_jit(donate="all-except-first")
def _placed(slots: Array, old: Flights, new: Flights) -> Flights:
    return _set(old, slots, new)


@eqx.filter_jit(donate="all-except-first")
def _advanced(
    constant: tuple[Sensors, Pilot], flights: Flights, moving: Bool[Array, "slots"]
) -> tuple[Flights, Seen]:
    sensors, pilot = constant

    def one(flights: Flights, moving: Flag) -> tuple[Loop, Seen]:
        new, flight = advance(flights.world, sensors, pilot, flights.loop, PERIODS)
        loop = tree_where(moving, new, flights.loop)
        distance = jax.vmap(flights.scene.distance)(flight.vehicle[:, :3])
        memory, known = loop.controller, loop.observation
        return loop, Seen(
            flight,
            distance,
            memory.phase,
            memory.attempts,
            loop.world.time,
            known.state(),
            known.deck.position,
        )

    loop, seen = eqx.filter_vmap(one)(flights, moving)
    return Flights(flights.world, flights.scene, flights.key, loop), seen


@eqx.filter_jit
def _ranges(lidar: LiDAR, flights: Flights, slots: Array, scans: Array) -> Float[Array, "slots rays"]:
    def one(key: PRNGKeyArray, loop: Loop, scene: Scene, scan: Array) -> Array:
        own = jax.random.fold_in(jax.random.fold_in(key, _SCANS), scan)
        return lidar.ranges(own, vehicle_state(loop.world), scene)

    chosen = _chosen(flights, slots)
    return jax.vmap(one)(chosen.key, chosen.loop, chosen.scene, scans)


@eqx.filter_jit(donate="all-except-first")
def _ordered(constant: tuple[Pilot, Array, Any], flights: Flights) -> Flights:
    pilot, slots, given = constant

    def one(flights: Flights, time: Array, plan: Reference | None, place: Array | None) -> Flights:
        memory = flights.loop.controller
        if plan is not None:
            return _with_memory(flights, pilot.with_plan(memory, plan, time))
        if place is not None:
            return _with_memory(flights, pilot.with_stop(memory, place, time))
        moving = eqx.tree_at(lambda f: f.world, flights, sent_off(flights.world, time))
        return _with_memory(moving, pilot.with_approach(memory, time))

    return _set(flights, slots, eqx.filter_vmap(one)(_chosen(flights, slots), *given))


def _with_memory(flights: Flights, memory: PilotState) -> Flights:
    return eqx.tree_at(lambda f: f.loop.controller, flights, memory)


def _chosen(tree: Any, slots: Array) -> Any:
    return jax.tree.map(lambda x: x[slots] if eqx.is_array(x) else x, tree)


def _set(old: Any, slots: Array, new: Any) -> Any:
    put = lambda a, b: a.at[slots].set(b) if eqx.is_array(a) else a  # noqa: E731
    return jax.tree.map(put, old, new)


def _stacked(trees: Sequence[Any]) -> Any:
    """Trees of arrays of the host as one, with an axis in front. All agree in the parts that are no arrays."""
    together = lambda *x: np.stack(x) if eqx.is_array_like(x[0]) else x[0]  # noqa: E731
    return jax.tree.map(together, *trees)


def _repeated(tree: Any, slots: int) -> Any:
    """The first row of every array, for all slots."""
    many = lambda x: jnp.broadcast_to(x[:1], (slots, *x.shape[1:])).copy()  # noqa: E731
    return jax.tree.map(lambda x: many(x) if eqx.is_array(x) else x, tree)


def _on_device(tree: Any) -> Any:
    """The same arrays without weak types: other ones would compile another program."""
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype) if eqx.is_array(x) else x, tree)


def _groups(slots: Sequence[int], size: int) -> Iterator[list[int]]:
    """Slots in groups of one size: the last one repeats its last slot."""
    for first in range(0, len(slots), size):
        group = list(slots[first : first + size])
        yield group + group[-1:] * (size - len(group))
