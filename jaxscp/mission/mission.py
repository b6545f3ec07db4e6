"""A whole mission by its seed."""

import dataclasses
import os

import numpy as np

from jaxscp.mission.cases import Case, Choices, draw_case
from jaxscp.mission.commander import Commander, carry_out
from jaxscp.mission.craft import Craft
from jaxscp.mission.outcome import Outcome, assess
from jaxscp.mission.planning import MissionPlanner
from jaxscp.simulation import Flight

GOAL_REACHED = 1.5
"""m, true distance from the goal: the odometry may have drifted by as much."""


@dataclasses.dataclass(frozen=True)
class Mission:
    """A mission that was carried out."""

    case: Case
    commander: Commander
    craft: Craft
    """The vehicle, with the record of the truth."""
    outcome: Outcome

    @property
    def accomplished(self) -> bool:
        """Whether the vehicle was at the goal, but for its drift, and landed."""
        return self.outcome.landed and self.outcome.goal_distance < GOAL_REACHED

    def save(self, file: str | os.PathLike) -> None:
        """Write the histories at 200 Hz (.npz): vehicle, carrier, estimate, deck, thrusts, distance."""
        record = self.craft.record
        flight = {field.name: getattr(record.flight(), field.name) for field in dataclasses.fields(Flight)}
        phases = np.array([phase.name for phase in record.phases])
        np.savez_compressed(file, **flight, distance=record.distance(), phases=phases)


def run_mission(name: str, seed: int, choices: Choices | None = None) -> Mission:
    """Fly the mission of a field and a seed; the same seed flies the same mission.

    Args:
        name: ``indoor`` or ``outdoor``.
        seed: any whole number.
        choices: numbers that are fixed instead of drawn.

    Raises:
        ValueError: no such field.
    """
    case = draw_case(name, seed, choices)
    craft = Craft(case)
    planner = MissionPlanner(case.field, craft.pilot.airframe)
    commander = Commander(craft, planner, case.field, np.asarray(case.goal))
    carry_out(commander)
    return Mission(
        case, commander, craft, assess(craft.record, int(craft.memory.attempts), np.asarray(case.goal))
    )
