"""A mission that was carried out."""

import dataclasses
import os

import numpy as np
from jaxtyping import Float

from jaxscp.mission.cases import Case, Request
from jaxscp.mission.commander import Commander
from jaxscp.mission.member import LOOK, Record
from jaxscp.mission.outcome import Outcome
from jaxscp.mission.phases import Phase
from jaxscp.simulation.simulate import TICK

GOAL_REACHED = 1.5
"""m, true distance from the goal: the odometry may have drifted by as much."""


@dataclasses.dataclass(frozen=True)
class Mission:
    """A mission that was carried out."""

    request: Request
    case: Case
    commander: Commander
    record: Record
    """The truth."""
    outcome: Outcome

    @property
    def accomplished(self) -> bool:
        """Whether the vehicle was at the goal, but for its drift, and landed."""
        return self.outcome.landed and self.outcome.goal_distance < GOAL_REACHED

    def tracking_errors(self) -> Float[np.ndarray, "ticks"]:
        """Distance of the estimated position from the plan, m; NaN outside a cruise."""
        places = np.asarray(self.record.flight().estimate)[:, :3]
        time = np.arange(1, len(places) + 1) * TICK
        errors = np.full(len(places), np.nan)
        cruising = np.repeat([phase == Phase.cruise for phase in self.record.phases], round(LOOK / TICK))
        for plan in self.commander.references:
            rows = cruising & (time > float(plan.start))
            samples = float(plan.start) + float(plan.step) * np.arange(len(plan.state))
            planned = [np.interp(time[rows], samples, np.asarray(plan.state)[:, axis]) for axis in range(3)]
            errors[rows] = np.linalg.norm(places[rows] - np.stack(planned, axis=1), axis=1)
        return errors

    def save(self, file: str | os.PathLike) -> None:
        """Write the histories at 200 Hz (.npz): vehicle, carrier, estimate, deck, thrusts, distance."""
        whole = self.record.flight()
        flight = {field.name: getattr(whole, field.name) for field in dataclasses.fields(whole)}
        phases = np.array([phase.name for phase in self.record.phases])
        np.savez_compressed(file, **flight, distance=self.record.distance(), phases=phases)
