"""``sweep``: run a study, store it, and go on where an earlier call was ended."""

import contextlib
import dataclasses
import functools
import os
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxscp.monte_carlo.chunk import ChunkJob, ChunkReport, Evaluator
from jaxscp.monte_carlo.engines import Engine, InProcess, Opened
from jaxscp.monte_carlo.errors import InvalidStudy, SweepError, extra
from jaxscp.monte_carlo.intervals import wilson
from jaxscp.monte_carlo.outcome import SUCCESS, Outcome, check_parameters, names_in_use
from jaxscp.monte_carlo.progress import Progress, Silent, Snapshot
from jaxscp.monte_carlo.results import Sweep, known_identity, stored_cases, study_of
from jaxscp.monte_carlo.solves import Solves
from jaxscp.monte_carlo.stopping import Ending, Observed, Stop
from jaxscp.monte_carlo.storage import ENDING, LOCK, Layout, Store
from jaxscp.monte_carlo.study import Study
from jaxscp.monte_carlo.trajectories import Keep, NoTrajectories
from jaxscp.solver.planner import Planner

CHUNK = 100


def sweep(
    study: Study,
    address: str | os.PathLike,
    *,
    engine: Engine = InProcess(),  # noqa: B008
    keep: Keep = NoTrajectories(),  # noqa: B008
    stop: tuple[Stop, ...] = (),
    progress: Progress | None = None,
    chunk: int = CHUNK,
) -> Sweep:
    """Run all cases of a study that its folder does not hold yet.

    The same call continues one that was ended at any moment: complete chunks are kept, all others computed.

    Args:
        study: to run.
        address: a folder, or any address of fsspec.
        engine: ``InProcess()``, ``Processes(count)`` or ``Workers(executor)``.
        keep: which trajectories are stored: ``AllTrajectories()``, ``FailedTrajectories()`` or ``EveryNth(n)``.
        stop: rules that end it early: ``NarrowShare(width)``, ``NarrowMean(of, width)`` or ``Budget(seconds)``.
        progress: ``Bar()``, ``Lines()`` or ``JSONLines()``.
        chunk: cases that are written together; Ctrl-C loses the present ones. A folder keeps its own.

    Raises:
        InvalidStudy: if the study contradicts itself, or a rule needs independent cases.
        SweepError: if the folder holds another study, or another process writes to it, or it cannot be written.
        ImportError: if the extra ``sweeps`` is missing.

    Example:
        >>> import tempfile
        >>> from jaxscp import monte_carlo as mc
        >>> study = mc.Study(
        ...     run=lambda dice: {"success": dice["sum"] > 0.25},
        ...     base={"sum": 0.5},
        ...     parameters=(mc.Parameter(lambda d: d["sum"], mc.Uniform(0.0, 1.0)),),
        ...     sampling=mc.Independent(200, seed=3),
        ... )
        >>> result = mc.sweep(study, tempfile.mkdtemp() + "/dice")
        >>> result.complete, 0.6 < float(result.dataset()["success"].mean()) < 0.9
        (200, True)
    """
    _check(study, stop, chunk)
    return _run(_Request(study, Store(address), engine, keep, tuple(stop), progress or Silent(), chunk))


class _Request(NamedTuple):
    """Arguments of ``sweep``."""

    study: Study
    store: Store
    engine: Engine
    keep: Keep
    stop: tuple[Stop, ...]
    progress: Progress
    chunk: int


def _run(asked: _Request) -> Sweep:
    began, study, store = time.perf_counter(), asked.study, asked.store
    try:
        with _writing(store), asked.engine.opened() as opened:
            run = _Run(_prepared(asked, opened), asked.stop, asked.progress, began)
            run.go(opened)
            run.end()
    except KeyboardInterrupt as error:
        ended = f"ended: {stored_cases(store)} of {study.count} cases are stored; the same sweep goes on from there"
        asked.progress.message(ended)
        error.add_note(
            f"{ended}. Chunks are stored whole: sweep(..., chunk=10) in a new folder stores sooner."
        )
        raise
    except OSError as error:
        raise SweepError(
            f"{store.address}: cannot be written: {error}. Finished chunks are kept; mend the cause and run the same "
            "sweep again."
        ) from error
    finally:
        asked.progress.close()
    return Sweep(store, study)


def _check(study: Study, stop: tuple[Stop, ...], chunk: int) -> None:
    if not isinstance(chunk, int) or chunk < 1:
        raise InvalidStudy(f"chunk: must be a positive whole number, got {chunk!r}.")
    for rule in stop:
        if rule.independent and not study.sampling.independent:
            raise InvalidStudy(
                f"stop: the interval of {type(rule).__name__} holds for independent cases only; "
                f"{type(study.sampling).__name__} takes its total from the study."
            )


def _prepared(asked: _Request, engine: Opened) -> ChunkJob:
    study, store = asked.study, asked.store
    identity = known_identity(study)
    stored = store.configuration()
    if stored is not None:
        store.check(stored, identity)
        layout = Layout.of(stored)
        if damaged := store.repair(layout):
            asked.progress.message(f"damaged, and made again: {_listed(damaged)}")
    else:
        store.check_empty()
        units = {parameter.name: parameter.unit for parameter in study.parameters}
        check_parameters(units)
        asked.progress.message(_starting(study, 0))
        found = engine.quantities(study)  # runs the base
        if both := sorted(set(units) & {*found, *names_in_use(found)}):
            raise InvalidStudy(
                f"parameters: {both[0]!r} is the name of a result too; name the parameter otherwise."
            )
        layout = Layout(study.count, min(asked.chunk, study.count), units, found)
        store.create(identity, layout)
    return ChunkJob(study, engine.evaluator, store, layout, asked.keep, stored is not None)


def _listed(things: list[Any]) -> str:
    text = ", ".join(map(str, things[:3]))
    return text if len(things) <= 3 else f"{text} and {len(things) - 3} more"


def _starting(study: Study, stored: int) -> str:
    """Line that tells what takes long before the first progress."""
    cases = f"{study.count} cases" + (f", {stored} of them stored" if stored else "")
    compiles = isinstance(study.run, Planner | Solves)
    return f"{cases}: {'compiling first' if compiles else 'starting'}, results follow ..."


@contextlib.contextmanager
def _writing(store: Store) -> Iterator[None]:
    """Nobody else writes to a local folder meanwhile; the lock ends with the process, however that ends."""
    if not store.local:
        yield
        return
    filelock = extra("filelock")
    fs, root = store.files
    fs.makedirs(root, exist_ok=True)
    try:
        with filelock.FileLock(f"{root}/{LOCK}", timeout=0):
            yield
    except filelock.Timeout as error:
        raise SweepError(
            f"{store.address}: another process writes to this folder now. Wait for its end, or name another folder."
        ) from error


class _Run:
    """One call of ``sweep``: which chunks are done, and whether that is enough."""

    def __init__(self, job: ChunkJob, stop: tuple[Stop, ...], progress: Progress, began: float):
        self.job, self.stop, self.progress, self.began = job, stop, progress, began
        self.done: dict[int, int] = {}
        """Successes of each finished chunk."""
        self.fresh, self.ending = 0, None
        self._first = functools.cache(
            self._read
        )  # complete cases change no more, and rules ask at every chunk
        for rule in stop:  # now, not at the first look, which may be hours away
            if isinstance(of := getattr(rule, "of", None), str):
                self._array(of)
        self._sound()

    def _sound(self) -> None:
        """Read finished chunks back; those that do not agree with their checksum are computed again."""
        store, layout = self.job.store, self.job.layout
        known = [index for index in store.done() if index < layout.chunks]
        for index in known:
            if (about := store.facts(index, layout.cases(index))) is not None:
                self.done[index] = about["successes"]
        ending = store.read(ENDING)
        cases = ending.get("cases") if isinstance(ending, dict) else None
        finished = min(-(-cases // layout.chunk), layout.chunks) if isinstance(cases, int) else 0
        for what, chunks in (
            ("damaged", [index for index in known if index not in self.done]),
            ("missing", [index for index in range(finished) if index not in known]),
        ):
            if chunks:
                are = "is" if len(chunks) == 1 else "are"
                self.progress.message(f"chunk {_listed(chunks)} {are} {what}, and computed again")

    def go(self, engine: Opened) -> None:
        """Compute the missing chunks, until a rule ends the sweep."""
        layout = self.job.layout
        missing = [index for index in range(layout.chunks) if index not in self.done]
        if self._enough() or not missing:
            return
        if self.job.resumed:
            self.progress.message(_starting(self.job.study, self.snapshot().done))
        self.job.store.remove(ENDING)  # of an earlier call: more cases are to come
        with contextlib.closing(engine.chunks(self.job, missing)) as reports:
            for report in reports:
                self._take(report)
                if self._enough():
                    break

    def _take(self, report: ChunkReport) -> None:
        self.done[report.index] = report.successes
        self.fresh += report.cases
        self.progress.update(self.snapshot())

    def complete(self) -> int:
        """Cases 0 to this number less one are all done."""
        layout = self.job.layout
        first = next((i for i in range(layout.chunks) if i not in self.done), layout.chunks)
        return min(first * layout.chunk, layout.count)

    def _enough(self) -> bool:
        seconds = time.perf_counter() - self.began
        seen = Observed(self.complete(), self.job.layout.count, seconds, self._first)
        found = [ending for rule in self.stop if (ending := rule.ended(seen)) is not None]
        self.ending = min(found, key=lambda ending: ending.cases, default=None)
        return self.ending is not None

    def _read(self, name: str, cases: int) -> np.ndarray:
        """Values of a result in cases 0 to ``cases`` - 1."""
        return np.asarray(self._array(name)[:cases])

    def _array(self, name: str) -> Any:
        arrays = self.job.store.arrays
        if name not in arrays:
            raise InvalidStudy(f"stop: no result is called {name!r}; there are {', '.join(sorted(arrays))}.")
        return arrays[name]

    def end(self) -> None:
        """Store where the sweep ended."""
        count = self.job.layout.count
        ending = self.ending or Ending(count, "all cases are computed")
        interval = ending.interval and list(ending.interval)
        self.job.store.write(ENDING, dataclasses.asdict(ending) | {"interval": interval})

    def snapshot(self) -> Snapshot:
        """For progress."""
        layout = self.job.layout
        sizes = {i: layout.cases(i).stop - layout.cases(i).start for i in self.done}
        done, successes = sum(sizes.values()), sum(self.done.values())
        known = SUCCESS in layout.quantities
        rate = self.fresh / max(time.perf_counter() - self.began, 1e-9)
        share = wilson(successes, done) if known and self.job.study.sampling.independent else None
        left = (layout.count - done) / rate if rate > 0 else None
        return Snapshot(done, layout.count, done - successes if known else None, share, rate, left)


def rerun(sweep: Sweep | Study, number: int, evaluator: Evaluator | None = None) -> Any:
    """Run one case again, and return all that ``study.run`` returns: a ``Solution``, say.

    The numbers are bitwise the stored ones on the same machine, if the engine ran single cases (``OneByOne``). After
    ``Together``, they agree to rounding; ``rerun(sweep, number, Together(size))`` runs the batch's own program.

    Args:
        sweep: with its study, or the study.
        number: of the case.
        evaluator: that runs it; the result is then an ``Outcome``. It takes a sweep, not a study.

    Raises:
        InvalidStudy: if there is no such case, or the sweep was opened without its study.
    """
    study = study_of(sweep)
    case = study.case(number)
    if evaluator is None:
        return study.run(case)
    if isinstance(sweep, Study):
        raise InvalidStudy("rerun: an evaluator needs the sweep, not the study alone.")
    stored = sweep.layout.quantities
    numbers = np.array([number])
    found, _ = evaluator.evaluate(study, numbers, study.values(numbers), stored)
    first = {name: array[0] for name, array in found.items()}
    path = {name.partition(".")[2]: array for name, array in first.items() if stored[name].trajectory}
    return Outcome(
        {name: array for name, array in first.items() if not stored[name].trajectory}, path or None
    )
