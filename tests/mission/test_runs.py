"""Many missions side by side: each slot goes on as soon as its commander has answered, and is used again."""

from concurrent.futures import Future

import numpy as np
import pytest

from jaxscp.mission import Request, WorkerCrews, run_mission, run_missions, runs, workers
from jaxscp.mission.crew import Answer
from jaxscp.mission.fleet import Start, _groups
from jaxscp.mission.mission import Mission

SAME = 1e-4
"""m, of touch-downs: rounding depends on the number of slots, and a flight keeps some of it."""


class FakeFleet:
    """Counts the parts of each slot's flight."""

    def __init__(self, slots, pilot):
        self.slots, self.parts, self.history = slots, {}, []

    def begin(self, starts):
        self.parts |= dict.fromkeys(starts, 0)

    def advance(self, active):
        self.history.append(tuple(active))
        self.parts |= {slot: self.parts[slot] + 1 for slot in active}
        return {slot: self.parts[slot] for slot in active}

    def order(self, orders):
        pass


class FakeCrew:
    """Flights of as many parts as their seed. A slow one's first answer comes when another flight has ended."""

    def __init__(self, slow=None):
        self.slow, self.seeds, self.late = slow, {}, None

    def begin(self, requests):
        self.seeds |= {slot: request.seed for slot, request in requests.items()}
        return [done({slot: Start(None, None, np.zeros(2), None) for slot in requests})]

    def look(self, rows):
        found = []
        for slot, part in rows.items():
            seed = self.seeds[slot]
            answer = {slot: Answer(None, part >= seed, seed)}
            if seed == self.slow and self.late is None:
                self.late = Future(), answer
                found.append(self.late[0])
                continue
            found.append(done(answer))
            if part >= seed and self.late is not None and not self.late[0].done():
                self.late[0].set_result(self.late[1])
        return found


def done(value):
    future = Future()
    future.set_result(value)
    return future


@pytest.fixture
def fleets(monkeypatch):
    """Fleets that were made."""
    made = []
    monkeypatch.setattr(runs, "Fleet", lambda *arguments: made.append(FakeFleet(*arguments)) or made[-1])
    monkeypatch.setattr(runs, "nominal_pilot", lambda: None)
    return made


@pytest.mark.parametrize("slots", [1, 2, 3, 10])
def test_all_missions_end_whatever_the_slots(fleets, slots):
    asked = [Request("indoor", seed) for seed in (3, 1, 4, 1, 5, 9, 2, 6)]
    assert sorted(run_missions(asked, slots, FakeCrew())) == [1, 1, 2, 3, 4, 5, 6, 9]
    assert fleets[0].slots == min(slots, 8)


def test_a_slow_commander_stops_his_own_flight_alone(fleets):
    asked = [Request("indoor", seed) for seed in (5, 3, 4)]
    assert list(run_missions(asked, 3, FakeCrew(slow=5))) == [3, 4, 5]
    history = fleets[0].history
    assert history[:3] == [(0, 1, 2), (1, 2), (1, 2)]
    assert sum(0 in active for active in history) == 5  # no part is lost


def test_missions_of_two_fields_are_refused(fleets):
    with pytest.raises(ValueError, match="expected one field, got indoor and outdoor"):
        list(run_missions([Request("indoor", 0), Request("outdoor", 0)], 2, FakeCrew()))


@pytest.mark.usefixtures("no_type_checks")
def test_what_is_no_request_is_named(fleets):
    with pytest.raises(ValueError, match=r"requests: expected Request\(field, seed\), got 'indoor'"):
        list(run_missions(["indoor"], 2, FakeCrew()))


@pytest.mark.usefixtures("no_type_checks")
def test_slots_and_workers_are_needed():
    for slots in (0, 1.5):
        with pytest.raises(ValueError, match=f"slots: expected a whole number, 1 or more, got {slots}"):
            run_missions([Request("indoor", 0)], slots=slots)
    with pytest.raises(ValueError, match="pool: expected one worker or more"):
        WorkerCrews([])


def test_no_request_flies_nothing(fleets):
    assert list(run_missions([], 2, FakeCrew())) == []


def test_groups_have_one_size():
    assert list(_groups([4, 5, 6], 2)) == [[4, 5], [6, 6]]
    assert list(_groups([], 2)) == []


def touchdown(mission: Mission) -> tuple[int, float]:
    """Seed and touch-down, of a worker."""
    assert mission.accomplished
    return mission.request.seed, mission.outcome.touchdown


@pytest.mark.nightly
def test_missions_side_by_side_are_those_alone():
    """In this process, and with commanders in two others; a slot is used twice."""
    asked = [Request("indoor", seed) for seed in range(3)]
    alone = {seed: run_mission(field, seed).outcome.touchdown for field, seed, _ in asked}
    together = dict(map(touchdown, run_missions(asked, slots=2)))
    with workers(2) as pool:
        planned_apart = dict(run_missions(asked, 2, WorkerCrews(pool, touchdown)))
    assert together == pytest.approx(alone, abs=SAME)
    assert planned_apart == pytest.approx(alone, abs=SAME)
