"""A whole mission by its seed."""

import dataclasses
import os

import numpy as np
from jaxtyping import Float

from jaxscp.mission.cases import Case, Choices, draw_case
from jaxscp.mission.commander import Commander, carry_out
from jaxscp.mission.craft import CHUNK, Craft
from jaxscp.mission.outcome import Outcome, assess
from jaxscp.mission.phases import Phase
from jaxscp.mission.planning import MissionPlanner
from jaxscp.simulation import Flight
from jaxscp.simulation.simulate import TICK

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

    def tracking_errors(self) -> Float[np.ndarray, "ticks"]:
        """Distance of the estimated position from the plan, m; NaN outside a cruise."""
        places = np.asarray(self.craft.record.flight().estimate)[:, :3]
        time = np.arange(1, len(places) + 1) * TICK
        errors = np.full(len(places), np.nan)
        cruising = np.repeat([phase == Phase.cruise for phase in self.craft.record.phases], int(CHUNK / TICK))
        for plan in self.commander.references:
            rows = cruising & (time > float(plan.start))
            samples = float(plan.start) + float(plan.step) * np.arange(len(plan.state))
            planned = [np.interp(time[rows], samples, np.asarray(plan.state)[:, axis]) for axis in range(3)]
            errors[rows] = np.linalg.norm(places[rows] - np.stack(planned, axis=1), axis=1)
        return errors

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
        seed: a whole number from 0 to 2^63 - 1.
        choices: numbers that are fixed instead of drawn.

    Raises:
        ValueError: no such field, or no such seed.
    """
    case = draw_case(name, seed, choices)
    craft = Craft(case)
    planner = MissionPlanner(case.field, craft.pilot.airframe)
    commander = Commander(craft, planner, case.field, np.asarray(case.goal))
    carry_out(commander)
    return Mission(
        case, commander, craft, assess(craft.record, int(craft.memory.attempts), np.asarray(case.goal))
    )
