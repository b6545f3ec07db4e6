"""The host's side of a fleet: commanders that look and order, and the assessment at the end of each flight."""

import contextlib
import dataclasses
import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np

from jaxscp.mission.cases import Case, Request, draw_case
from jaxscp.mission.commander import Commander, Task
from jaxscp.mission.fleet import Start
from jaxscp.mission.member import Member, Order, Record, Row, nominal_pilot
from jaxscp.mission.mission import Mission
from jaxscp.mission.outcome import Outcome, assess
from jaxscp.mission.phases import Phase
from jaxscp.mission.pilot import Pilot
from jaxscp.mission.planning import MissionPlanner

TIME_LIMIT = 150.0
"""s of a flight."""
_REST = 2  # parts of the flight after its end


class Answer(NamedTuple):
    """What follows from a look."""

    order: Order | None
    ended: bool = False
    result: Any = None
    """Of a flight that ended."""


@runtime_checkable
class Commanders(Protocol):
    """Begins flights and commands them, by slot of the fleet. Each future has results of some slots."""

    def begin(self, requests: Mapping[int, Request]) -> "list[Future[dict[int, Start]]]":
        """Draw cases."""
        ...

    def look(self, rows: Mapping[int, Row]) -> "list[Future[dict[int, Answer]]]":
        """Take half a second of flights, and answer."""
        ...


@dataclasses.dataclass
class _Duty:
    """One flight."""

    request: Request
    case: Case
    commander: Commander
    member: Member
    record: Record
    rest: int = _REST

    def over(self) -> bool:
        """Whether it has ended, and the parts after its end are flown."""
        ended = self.commander.task == Task.done or self.member.time >= TIME_LIMIT
        if ended:
            self.rest -= 1
        return ended and self.rest < 0

    def mission(self) -> Mission:
        """The flight that ended."""
        outcome = assess(self.record, self.member.attempts, np.asarray(self.case.goal))
        return Mission(self.request, self.case, self.commander, self.record, outcome)


class Crew:
    """Commanders in this process.

    Args:
        finish: a function of ``Mission``, whose value is kept. By default all is.
    """

    def __init__(self, finish: Callable[[Mission], Any] = lambda mission: mission) -> None:
        self._finish = finish
        self._duties: dict[int, _Duty] = {}
        self._pilot: Pilot | None = None
        self._planners: dict[str, MissionPlanner] = {}

    def begin(self, requests: Mapping[int, Request]) -> list[Future[dict[int, Start]]]:
        """See ``Commanders``."""
        return [_done(self.begun(requests))]

    def look(self, rows: Mapping[int, Row]) -> list[Future[dict[int, Answer]]]:
        """See ``Commanders``."""
        return [_done(self.answers(rows))]

    def begun(self, requests: Mapping[int, Request]) -> dict[int, Start]:
        """Cases of new flights."""
        cases = {slot: draw_case(*request) for slot, request in requests.items()}
        self._duties |= {slot: self._duty(requests[slot], case) for slot, case in cases.items()}
        return {slot: Start.of(case) for slot, case in cases.items()}

    def answers(self, rows: Mapping[int, Row]) -> dict[int, Answer]:
        """Answers to looks."""
        return {slot: self._answer(slot, row) for slot, row in rows.items()}

    def _duty(self, request: Request, case: Case) -> _Duty:
        pilot = self._pilot = self._pilot or nominal_pilot()
        field = case.field
        planner = self._planners.setdefault(field.name, MissionPlanner(field, pilot.airframe))
        member = Member(pilot, np.asarray(case.lidar.directions))
        commander = Commander(member, planner, field, np.asarray(case.goal))
        return _Duty(request, case, commander, member, Record())

    def _answer(self, slot: int, row: Row) -> Answer:
        duty = self._duties[slot]
        duty.member.advanced(row)
        duty.record.add(duty.member.phase, row.flight, row.distance)
        if duty.rest == _REST:
            duty.commander.look()
        if duty.over():
            return Answer(None, True, self._finish(self._duties.pop(slot).mission()))
        return Answer(duty.member.ordered())


def result(mission: Mission) -> tuple[Request, Outcome]:
    """What ``WorkerCrews`` keeps of a mission by default: records are large."""
    return mission.request, mission.outcome


class WorkerCrews:
    """Commanders in processes, each of which keeps its slots.

    Args:
        pool: executors of one process each, of ``workers``. Several fleets may share them.
        finish: a function of ``Mission``, whose value is kept, in a module that the processes can import. By default
            request and outcome are.
    """

    def __init__(self, pool: Sequence[Executor], finish: Callable[[Mission], Any] = result) -> None:
        if not pool:
            raise ValueError("pool: expected one worker or more, got none")
        self._pool, self._finish = pool, finish
        self._number = next(_numbers)

    def begin(self, requests: Mapping[int, Request]) -> list[Future[dict[int, Start]]]:
        """See ``Commanders``."""
        return [self._asked(_begun, slot, {slot: request}) for slot, request in requests.items()]

    def look(self, rows: Mapping[int, Row]) -> list[Future[dict[int, Answer]]]:
        """See ``Commanders``. Plans take long, and are made at rest: those flights come last, and one by one."""
        quick: dict[int, dict[int, Row]] = {}
        for slot, row in rows.items():
            if row.phase != Phase.hover:
                quick.setdefault(slot % len(self._pool), {})[slot] = row
        resting = [(slot, {slot: row}) for slot, row in rows.items() if row.phase == Phase.hover]
        return [self._asked(_answers, slot, share) for slot, share in (*quick.items(), *resting)]

    def _asked(self, function: Callable[..., Any], slot: int, values: Mapping[int, Any]) -> Future[Any]:
        worker = self._pool[slot % len(self._pool)]
        return worker.submit(function, self._number, self._finish, values)


_numbers = itertools.count()  # of the crews that this process asks
_crews: dict[int, Crew] = {}  # of a worker process, by those numbers


def _begun(number: int, finish: Callable[[Mission], Any], requests: Mapping[int, Request]) -> Any:
    return _crews.setdefault(number, Crew(finish)).begun(requests)


def _answers(number: int, finish: Callable[[Mission], Any], rows: Mapping[int, Row]) -> Any:
    return _crews[number].answers(rows)


def _done(value: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(value)
    return future


@contextlib.contextmanager
def workers(count: int) -> Iterator[list[ProcessPoolExecutor]]:
    """Processes for ``WorkerCrews``, each on its core. They use the CPU alone: the device is the fleet's.

    Args:
        count: of processes; one core should stay free for the process of the fleet.
    """
    context = multiprocessing.get_context("spawn")  # a fork would copy JAX's threads in any state
    double = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
    start = {"mp_context": context, "initializer": _started}
    pools = [ProcessPoolExecutor(1, **start, initargs=(double, number)) for number in range(count)]
    try:
        yield pools
    finally:
        for pool in pools:
            pool.shutdown(wait=True, cancel_futures=True)


def _started(double: bool, number: int) -> None:
    """Set up a worker: no answer to Ctrl-C (the caller answers), its core, the caller's precision, the CPU alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})
    jax.config.update("jax_enable_x64", double)
    jax.config.update("jax_platforms", "cpu")
