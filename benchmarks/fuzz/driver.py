"""Cases in a process of their own: one that dies or hangs is a fault of its case, and the next process goes on."""

import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

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


def run_all(count: int, seed: int, kinds: tuple[str, ...], first: int = 0) -> Iterator[Record]:
    """Run the cases ``first`` to ``first + count``, one after another, in a process that is begun again if it dies."""
    number, context = first, multiprocessing.get_context("spawn")
    while number < first + count:
        here, there = context.Pipe(duplex=False)
        worker = context.Process(target=_work, args=(there, seed, number, first + count, kinds), daemon=True)
        worker.start()
        there.close()
        for record in _received(here, worker, seed, number, kinds):
            yield record
            number = record.number + 1


def _received(
    here: Connection, worker: Any, seed: int, number: int, kinds: tuple[str, ...]
) -> Iterator[Record]:
    """Records of a process, the last one of its end if that is a fault."""
    while True:
        try:
            if here.poll(PATIENCE):
                record = here.recv()
                if record is None:
                    worker.join()
                    return
                number = record.number + 1
                yield record
                continue
            ending = Ending("hang", f"no answer in {PATIENCE:.0f} s")
        except EOFError:
            worker.join()
            ending = Ending("crash", f"the process ended with {worker.exitcode}")
        worker.kill()
        worker.join()
        case = case_of(seed, number, kinds)
        yield Record(number, case.kind, case.mutation, *ending, 0.0)
        return


def _work(there: Connection, seed: int, first: int, end: int, kinds: tuple[str, ...]) -> None:
    jax.config.update("jax_enable_x64", True)
    for number in range(first, end):
        there.send(run_case(number, case_of(seed, number, kinds)))
    there.send(None)
