"""One vehicle of a fleet: what its commander sees of it and may order, and its true record for the assessment."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxscp.control import Reference
from jaxscp.mission.mapping import Points, in_odometry_frame
from jaxscp.mission.phases import Phase
from jaxscp.mission.pilot import SAMPLES, Pilot
from jaxscp.mission.rules import Rules
from jaxscp.simulation import Flight, simulated_mav

LOOK = 0.5
"""s between two looks of the commander."""
_LATENCY = 0.1  # s from an order to the begin of a plan


class Row(NamedTuple):
    """What half a second of one flight leaves."""

    flight: Flight
    """The truth, for the record alone."""
    distance: Float[np.ndarray, "ticks"]
    """True distance from the obstacles, m; for the record alone."""
    phase: Any
    attempts: Any
    """Approaches that were begun."""
    time: Any
    """s since the begin."""
    state: Float[np.ndarray, "13"]
    """Estimated."""
    deck: Float[np.ndarray, "3"]
    """Estimated centre of the deck's surface, m."""
    ranges: Float[np.ndarray, "rays"] | None
    """Of a scan, m, zero without return; None in phases that need none."""


class Order(NamedTuple):
    """An order to the pilot: a phase, and its target."""

    phase: Phase
    """Cruise with a plan, hover at a place, or approach."""
    time: float
    """s, now."""
    plan: Reference | None = None
    place: Float[np.ndarray, "3"] | None = None
    """m"""


@dataclasses.dataclass
class Member:
    """A vehicle for its commander. It has estimates and scans; the truth goes to a record.

    Args:
        pilot: that flies it.
        directions: (rays, 3) of a scan, unit vectors in body axes.
    """

    pilot: Pilot
    directions: Float[np.ndarray, "rays 3"]
    _row: Row | None = None
    _ordered: Order | None = None

    @property
    def rules(self) -> Rules:
        """Heights, speeds and limits of the pilot."""
        return self.pilot.rules

    @property
    def phase(self) -> Phase:
        """Present phase."""
        return Phase.on_deck if self._row is None else Phase(int(self._row.phase))

    @property
    def time(self) -> float:
        """s since the begin."""
        return 0.0 if self._row is None else float(self._row.time)

    @property
    def attempts(self) -> int:
        """Approaches that were begun."""
        return 0 if self._row is None else int(self._row.attempts)

    @property
    def _seen(self) -> Row:
        assert self._row is not None, "the flight has not begun"
        return self._row

    def state(self) -> Float[np.ndarray, "13"]:
        """Estimated state."""
        return self._seen.state

    def deck(self) -> Float[np.ndarray, "3"]:
        """Estimated centre of the deck's surface, m."""
        return self._seen.deck

    def scan(self) -> Points:
        """Points of one scan in the frame of the odometry, m."""
        ranges = self._seen.ranges
        assert ranges is not None, f"no scan in phase {self.phase.name}"
        return in_odometry_frame(ranges, self.directions, self.state())

    def follow(self, trajectory: Any) -> Reference:
        """Order a cruise along a plan, and return its reference."""
        hover = self.pilot.still.control[0]
        plan = self.pilot.nmpc.follow(trajectory, self.time + _LATENCY, hover, SAMPLES)
        self._ordered = Order(Phase.cruise, self.time, plan=jax.tree.map(np.asarray, plan))
        return plan

    def stop(self, place: Float[np.ndarray, "3"]) -> None:
        """Order a hover at a place, m."""
        self._ordered = Order(Phase.hover, self.time, place=np.asarray(place, float))

    def land(self) -> None:
        """Order the approach, and tell the carrier, which may move from now on."""
        self._ordered = Order(Phase.approach, self.time)

    def advanced(self, row: Row) -> None:
        """Take the record and the estimates of the next part."""
        self._row, self._ordered = row, None

    def ordered(self) -> Order | None:
        """The order since then, if any."""
        return self._ordered


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


def nominal_pilot() -> Pilot:
    """The pilot of the vehicle as it was designed; the true vehicle of a case differs."""
    return Pilot.of(simulated_mav())
