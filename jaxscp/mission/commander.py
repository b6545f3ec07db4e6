"""The commander: scans, plans and orders between parts of a flight. It lives on the host and sees no truth."""

import enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from jaxscp.control import Reference
from jaxscp.corridor import PointCloud
from jaxscp.mission.fields import Field
from jaxscp.mission.mapping import Points, RecentMap
from jaxscp.mission.phases import Phase
from jaxscp.mission.planning import Planned, retreat
from jaxscp.simulation.vehicles import FEET_DEPTH

MEMORY = 12.0  # m of the way after which a scan is forgotten
LEAST_CLEARANCE = 0.23  # m from the latest scan to the rest of the plan: the hull and as much for tracking
_STOPPING = 0.35  # s of the plan that a stop still takes
_FAILURES = 6  # looks without a plan before a task is given up
_ABOVE_GROUND = 0.4  # m: lower points are the ground


@runtime_checkable
class Vehicle(Protocol):
    """A vehicle for a commander: estimates, scans and orders. ``Member`` is one."""

    @property
    def rules(self) -> Any:
        """Heights, speeds and limits of its pilot."""
        ...

    @property
    def phase(self) -> Any:
        """Present phase."""
        ...

    @property
    def time(self) -> float:
        """s since the begin."""
        ...

    def state(self) -> Float[np.ndarray, "13"]:
        """Estimated state."""
        ...

    def deck(self) -> Float[np.ndarray, "3"]:
        """Estimated centre of the deck's surface, m."""
        ...

    def scan(self) -> Points:
        """Points of one scan in the frame of the odometry, m."""
        ...

    def follow(self, trajectory: Any) -> Reference:
        """Order a cruise along a plan, and return its reference."""
        ...

    def stop(self, place: Float[np.ndarray, "3"]) -> None:
        """Order a hover at a place, m."""
        ...

    def land(self) -> None:
        """Order the approach, and tell the carrier."""
        ...


@runtime_checkable
class Plans(Protocol):
    """Makes plans; ``MissionPlanner`` does."""

    def plan(self, cloud: PointCloud, start: Any, goal: Any, deck: Any) -> Planned:
        """A plan from rest to rest."""
        ...


class Task(enum.Enum):
    """Task of the commander."""

    out = enum.auto()
    """On the way to the goal."""
    back = enum.auto()
    """On the way to the deck."""
    landing = enum.auto()
    done = enum.auto()


_ARRIVED = {Task.out: 0.5, Task.back: 1.5, Task.landing: 0.0}
"""m from the end of a task's plan; near the deck, the approach does the rest."""


class Commander:
    """Carries a mission out: to the goal and back onto the deck.

    Args:
        craft: the vehicle.
        planner: of plans.
        field: limits and sensors of the place.
        goal: in the world at the start, m.
    """

    def __init__(self, craft: Vehicle, planner: Plans, field: Field, goal: Float[np.ndarray, "3"]) -> None:
        self.craft, self.planner, self.field = craft, planner, field
        self.goal, self.task = np.asarray(goal), Task.out
        self.map = RecentMap(MEMORY, denoise=field.leaves > 0.0)
        self.plans: list[tuple[float, Planned]] = []
        """Time in s, and each plan that was asked for."""
        self.references: list[Reference] = []
        """Of each cruise, for the controller."""
        self.failures = 0
        self.aborts: list[str] = []

    def look(self) -> None:
        """One look at phase, scan and plan; orders follow. Call it after every part of the flight."""
        phase = self.craft.phase
        if phase in (Phase.landed, Phase.safe_hover):
            self.task = Task.done
        elif phase in (Phase.hover, Phase.cruise):
            self.map.add(self.craft.scan(), self.craft.state()[:3])
            (self._at_rest if phase == Phase.hover else self._on_the_way)()

    def _at_rest(self) -> None:
        """Choose the next task, or plan for this one."""
        here = self.craft.state()[:3]
        if np.linalg.norm(here - self._place()) < _ARRIVED[self.task]:
            self.failures = 0
            self.task = Task.back if self.task == Task.out else Task.landing
        if self.task == Task.landing:
            self.craft.land()
            return
        planned = self.planner.plan(self.map.cloud(), here, self._place(), self.craft.deck())
        self.plans.append((self.craft.time, planned))
        if planned.trajectory is not None:
            self.references.append(self.craft.follow(planned.trajectory))
            return
        self.failures += 1
        self._make_room(here)
        self.map.forget()
        if self.failures >= _FAILURES and self.task == Task.out:
            self.aborts.append("no route to the goal")
            self.failures, self.task = 0, Task.back

    def _make_room(self, here: Float[np.ndarray, "3"]) -> None:
        """Draw back from obstacles that are close: from there, a plan may start."""
        place = retreat(self.map.latest().points, here)
        if place is not None:
            self.craft.stop(place)

    def _on_the_way(self) -> None:
        """Stop where the latest scan shows too little clearance."""
        plan, now = self.references[-1], self.craft.time
        begin = int(max(0.0, (now - float(plan.start)) / float(plan.step)))
        rest = np.asarray(plan.state)[begin:, :3]
        if self.map.latest().blocks(rest, LEAST_CLEARANCE, _ABOVE_GROUND):
            self.aborts.append("blocked plan")
            place, _ = plan.at(now + _STOPPING)
            self.craft.stop(np.asarray(place)[:3])

    def _place(self) -> Float[np.ndarray, "3"]:
        """Where the task's plan ends."""
        if self.task == Task.out:
            return self.goal
        height = float(self.craft.rules.return_height) + FEET_DEPTH
        return self.craft.deck() + np.array([0.0, 0.0, height])
