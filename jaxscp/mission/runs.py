"""Missions by their seeds: one, or many side by side."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

from jaxscp.core.arrays import check_whole
from jaxscp.mission.cases import Choices, Request
from jaxscp.mission.crew import Answer, Commanders, Crew
from jaxscp.mission.fleet import Fleet, Start
from jaxscp.mission.member import nominal_pilot
from jaxscp.mission.mission import Mission

_QUORUM = 0.5  # of the flights: so many must be ready for a part of the flight


def run_mission(name: str, seed: int, choices: Choices | None = None) -> Mission:
    """Fly the mission of a field and a seed; the same seed flies the same mission.

    Args:
        name: ``indoor`` or ``outdoor``.
        seed: a whole number from 0 to 2^63 - 1.
        choices: numbers that are fixed instead of drawn.

    Raises:
        ValueError: no such field, or no such seed.
    """
    return next(run_missions([Request(name, seed, choices)], slots=1))


def run_missions(
    requests: Iterable[Request], slots: int = 8, crew: Commanders | None = None
) -> Iterator[Any]:
    """Fly missions of one field side by side; yields each as it ends.

    The physics of all slots is one batch on JAX's default device. Commanders plan on the host. When a flight ends, the
    next begins in its slot. Rounding depends on the number of slots: a seed then flies the same mission but for that.

    Args:
        requests: missions, all of one field.
        slots: flights at a time, at most.
        crew: commanders; ``Crew()`` by default, in this process. ``WorkerCrews`` plans on more cores.

    Yields:
        ``Mission``, or the crew's ``finish`` of it.

    Raises:
        ValueError: no such field or seed, several fields, or no slot.
    """
    check_whole("slots", slots, 1)
    rest = iter(requests)
    first = list(itertools.islice(rest, slots))  # slots without a flight would be computed all the same
    return _Runs(itertools.chain(first, rest), max(len(first), 1), crew or Crew()).results()


class _Runs:
    """The loop of a fleet and its crew. A flight whose commander still plans waits; the others fly on."""

    def __init__(self, requests: Iterable[Request], slots: int, crew: Commanders) -> None:
        self.waiting, self.crew = iter(requests), crew
        self.fleet = Fleet(slots, nominal_pilot())
        self.free, self.ready = set(range(slots)), set()
        self.field: str | None = None
        self.pending: set[Future[Any]] = set()

    def results(self) -> Iterator[Any]:
        """Of each mission, as it ends, the part that the crew keeps."""
        while self.begin() or self.pending or self.ready:
            yield from self.taken(self.answered())
            if self.ready:
                rows = self.fleet.advance(sorted(self.ready))
                self.ready.clear()
                self.pending |= set(self.crew.look(rows))

    def answered(self) -> dict[int, Start | Answer]:
        """Cases and answers, by slot, as soon as enough flights have theirs."""
        found: dict[int, Start | Answer] = {}
        enough = _QUORUM * (self.fleet.slots - len(self.free))
        while self.pending and len(self.ready) + len(found) < enough:
            done, self.pending = wait(self.pending, return_when=FIRST_COMPLETED)
            found |= {slot: value for future in done for slot, value in future.result().items()}
        return found

    def begin(self) -> bool:
        """Ask for cases of flights in free slots; whether there are any."""
        new = dict(zip(sorted(self.free), itertools.islice(self.waiting, len(self.free)), strict=False))
        for request in new.values():
            if not isinstance(request, Request):
                raise ValueError(f"requests: expected Request(field, seed), got {request!r}")
            self.field = self.field or request.field
            if request.field != self.field:
                raise ValueError(f"requests: expected one field, got {self.field} and {request.field}")
        self.free -= set(new)
        self.pending |= set(self.crew.begin(new)) if new else set()
        return bool(new)

    def taken(self, found: Mapping[int, Start | Answer]) -> Iterator[Any]:
        """Begin flights whose case is drawn, give orders, and yield results of flights that ended."""
        self.fleet.begin({slot: value for slot, value in found.items() if isinstance(value, Start)})
        answers = {slot: value for slot, value in found.items() if isinstance(value, Answer)}
        self.fleet.order({slot: answer.order for slot, answer in answers.items() if answer.order is not None})
        over = {slot for slot, answer in answers.items() if answer.ended}
        self.free |= over
        self.ready |= set(found) - over
        yield from (answers[slot].result for slot in sorted(over))
