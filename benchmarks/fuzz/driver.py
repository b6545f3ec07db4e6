"""Cases in a process of their own: one that dies or hangs is a fault of its case, and the next process goes on."""

import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait

import jax
import numpy as np

from benchmarks.fuzz import clouds, commands, flights
from benchmarks.fuzz.case import Case, Ending, Record

KINDS: dict[str, tuple[float, Callable[[np.random.Generator], Case]]] = {
    "scenario": (0.42, flights.scenario),
    "corridor": (0.16, flights.corridor),
    "cloud": (0.06, clouds.cloud),
    "file": (0.24, clouds.file),
    "command": (0.12, commands.command),
}
PATIENCE = 600.0  # s for a case, which may compile on a busy machine


def case_of(seed: int, number: int, kinds: tuple[str, ...] = tuple(KINDS)) -> Case:
    """The case of a seed and a number; the same at every call."""
    rng = np.random.default_rng([seed, number])
    weights = np.array([KINDS[kind][0] for kind in kinds])
    return KINDS[kinds[rng.choice(len(kinds), p=weights / weights.sum())]][1](rng)


def run_case(number: int, case: Case) -> Record:
    """Run a case here."""
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ending = case.run()
    except Exception as error:  # a fault, of any class
        ending = Ending("traceback", f"{type(error).__name__}: {error}")
    return Record(number, case.kind, case.mutation, *ending, time.perf_counter() - began)


def run_all(
    count: int, seed: int, kinds: tuple[str, ...], first: int = 0, workers: int = 1
) -> Iterator[Record]:
    """Run the cases ``first`` to ``first + count``, each worker its part of them."""
    parts = [range(first + row, first + count, workers) for row in range(min(workers, count))]
    running = [_Worker(seed, numbers, kinds) for numbers in parts]
    while running:
        ready = wait([worker.answers for worker in running], timeout=1.0)
        for worker in list(running):
            if record := worker.answer(worker.answers in ready):
                yield record
            if not worker.numbers:
                worker.process.join()
                running.remove(worker)


class _Worker:
    """A process that runs cases one after another, and is begun again if it dies or hangs."""

    def __init__(self, seed: int, numbers: range, kinds: tuple[str, ...]):
        self.seed, self.numbers, self.kinds = seed, numbers, kinds
        self._begin()

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.answers, there = context.Pipe(duplex=False)
        arguments = there, self.seed, self.numbers, self.kinds
        self.process = context.Process(target=_work, args=arguments, daemon=True)
        self.process.start()
        there.close()
        self.since = time.perf_counter()

    def answer(self, ready: bool) -> Record | None:
        """The record of the next case, of its fault if the process died or hangs; None while it runs."""
        try:
            if not ready and time.perf_counter() - self.since < PATIENCE:
                return None
            record = self.answers.recv() if ready else self._failed("hang", f"no answer in {PATIENCE:.0f} s")
        except EOFError:
            self.process.join()
            record = self._failed("crash", f"the process ended with {self.process.exitcode}")
        self.numbers, self.since = self.numbers[1:], time.perf_counter()
        if record.ending in ("hang", "crash") and self.numbers and not self.process.is_alive():
            self._begin()
        return record

    def _failed(self, name: str, detail: str) -> Record:
        self.process.kill()
        self.process.join()
        case = case_of(self.seed, self.numbers[0], self.kinds)
        return Record(self.numbers[0], case.kind, case.mutation, name, detail, 0.0)


def _work(there: Connection, seed: int, numbers: range, kinds: tuple[str, ...]) -> None:
    jax.config.update("jax_enable_x64", True)
    for number in numbers:
        there.send(run_case(number, case_of(seed, number, kinds)))
