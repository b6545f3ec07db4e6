"""Who computes the chunks: this process, or workers behind any ``concurrent.futures.Executor``."""

import concurrent.futures
import contextlib
import dataclasses
import functools
import importlib
import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import types
from collections.abc import Generator, Iterable, Iterator
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax

from jaxscp.aot import cache_folder
from jaxscp.core.threads import usable_cores
from jaxscp.monte_carlo.chunk import ChunkJob, ChunkReport, Evaluator
from jaxscp.monte_carlo.errors import SweepError, extra
from jaxscp.monte_carlo.evaluators import OneByOne
from jaxscp.monte_carlo.outcome import Quantity
from jaxscp.monte_carlo.study import Study


@runtime_checkable
class Engine(Protocol):
    """Gives something that computes chunks."""

    def opened(self) -> contextlib.AbstractContextManager["Opened"]:
        """A context, in which chunks are computed."""
        ...


@runtime_checkable
class Opened(Protocol):
    """Computes chunks in any order."""

    @property
    def evaluator(self) -> Evaluator:
        """How each process runs its cases."""
        ...

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """Results of a case, by name."""
        ...

    def chunks(self, job: ChunkJob, indices: Iterable[int]) -> Generator[ChunkReport, None, None]:
        """Compute chunks, and yield a report of each."""
        ...


@dataclasses.dataclass(frozen=True)
class InProcess:
    """This process.

    Args:
        evaluator: ``OneByOne()``, or ``Together(size)`` for GPUs.
    """

    evaluator: Evaluator = OneByOne()  # noqa: RUF009

    def opened(self) -> contextlib.AbstractContextManager[Opened]:
        """See ``Engine``."""
        return contextlib.nullcontext(self)

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """See ``Opened``."""
        return self.evaluator.quantities(study)

    def chunks(self, job: ChunkJob, indices: Iterable[int]) -> Generator[ChunkReport, None, None]:
        """See ``Opened``."""
        yield from map(job.run, indices)


@dataclasses.dataclass(frozen=True)
class Workers:
    """Anything with the interface of ``concurrent.futures.Executor``: of Dask, ``client.get_executor()``.

    Args:
        executor: workers that can import jaxscp, and write to the sweep's folder.
        evaluator: how each worker runs its cases.
        in_flight: chunks that are handed out at a time; twice the number of workers keeps them busy.
    """

    executor: Any
    evaluator: Evaluator = OneByOne()  # noqa: RUF009
    in_flight: int = 2 * (os.cpu_count() or 1)

    def opened(self) -> contextlib.AbstractContextManager[Opened]:
        """See ``Engine``."""
        return contextlib.nullcontext(self)

    def quantities(self, study: Study) -> dict[str, Quantity]:
        """See ``Opened``."""
        payload = _packed((study, self.evaluator))
        with _blaming_workers():
            return self.executor.submit(_quantities, payload).result()

    def chunks(self, job: ChunkJob, indices: Iterable[int]) -> Generator[ChunkReport, None, None]:
        """See ``Opened``."""
        payload, pending, rest = _packed(job), set(), iter(indices)
        try:
            with _blaming_workers():
                while True:
                    for index in rest:
                        pending.add(self.executor.submit(_run, payload, index))
                        if len(pending) >= self.in_flight:
                            break
                    if not pending:
                        return
                    done, pending = concurrent.futures.wait(pending, return_when="FIRST_COMPLETED")
                    for future in done:
                        yield future.result()
        finally:
            for future in pending:
                future.cancel()


@contextlib.contextmanager
def _blaming_workers() -> Iterator[None]:
    try:
        yield
    except concurrent.futures.BrokenExecutor as error:
        raise SweepError(
            "a worker process ended, perhaps for lack of memory. Finished chunks are stored: run the same sweep "
            "again, with fewer workers perhaps."
        ) from error


@dataclasses.dataclass(frozen=True)
class Processes:
    """Processes of this machine, each on its own cores: for functions that threads would not speed up.

    Each process compiles for itself; ``jaxscp.use_cache`` lets them share.

    Args:
        count: of processes; the number of usable cores by default.
        evaluator: how each runs its cases.
    """

    count: int = usable_cores()
    evaluator: Evaluator = OneByOne()  # noqa: RUF009

    @contextlib.contextmanager
    def opened(self) -> Iterator[Workers]:
        """See ``Engine``: starts the processes, and ends them."""
        context = multiprocessing.get_context("spawn")  # a fork would copy JAX's threads in any state
        shared = _Shared(context.Value("i", 0), self.count, os.getpid(), context.RawValue("b", 0))
        pool = _Pool(self.count, mp_context=context, initializer=_started, initargs=(shared,))
        try:
            yield Workers(pool, self.evaluator, 2 * self.count)
        except KeyboardInterrupt:
            shared.interrupted.value = 1
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


class _Pool(concurrent.futures.ProcessPoolExecutor):
    """Starts its workers when they are needed, and whole: Ctrl-C meanwhile would end them with tracebacks."""

    def submit(self, *arguments: Any, **more: Any) -> Any:
        """See ``Executor``."""
        with _after_interrupts():
            return super().submit(*arguments, **more)


@contextlib.contextmanager
def _after_interrupts() -> Iterator[None]:
    """Ctrl-C counts after the block. Processes that the block starts inherit that this thread does not hear of it."""
    main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    if not main or handler is None or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    noted: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: noted.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, handler)
        if noted:
            signal.raise_signal(signal.SIGINT)


class _Shared(NamedTuple):
    """What workers share with their parent."""

    counter: Any
    """Workers so far; has a lock."""
    count: int
    """Of workers."""
    parent: int
    """Its process."""
    interrupted: Any
    """Whether the parent got Ctrl-C. Without a lock, which a worker could keep when it is killed."""


def _started(shared: _Shared) -> None:
    """Set up a worker: its cores, no answer to Ctrl-C (the parent answers), and an end with the parent's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with shared.counter.get_lock():
        number = shared.counter.value
        shared.counter.value += 1
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        share = cores[number % shared.count :: shared.count] or cores
        os.sched_setaffinity(0, share)

    def watch() -> None:
        # compilation cannot be interrupted, and chunks without a marker are computed again: end at once
        while os.getppid() == shared.parent and not shared.interrupted.value:
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _packed(value: Any) -> bytes:
    """A value, functions of notebooks included, with the settings that it needs."""

    class Pickler(extra("cloudpickle").Pickler):
        """Packages that import lazily have a class of their own, which cloudpickle does not know."""

        def reducer_override(self, obj: Any) -> Any:
            if (
                isinstance(obj, types.ModuleType)
                and obj is sys.modules.get(obj.__name__)
                and not _is_main(obj)
            ):
                return importlib.import_module, (obj.__name__,)
            return super().reducer_override(obj)

    stream = io.BytesIO()
    Pickler(stream).dump(value)
    double = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
    return pickle.dumps((double, cache_folder.folder(), stream.getvalue()))


def _is_main(module: types.ModuleType) -> bool:
    return module.__name__ == "__main__"


@functools.lru_cache(maxsize=2)
def _unpacked(payload: bytes) -> Any:
    """The value; the same object in each call, so that its functions compile once."""
    double, folder, value = pickle.loads(payload)
    jax.config.update("jax_enable_x64", double)  # as the caller's process, and before arrays are made
    if folder is not None and cache_folder.folder() != folder:
        cache_folder.use_cache(folder)
    return pickle.loads(value)


def _quantities(payload: bytes) -> dict[str, Quantity]:
    study, evaluator = _unpacked(payload)
    return evaluator.quantities(study)


def _run(payload: bytes, index: int) -> ChunkReport:
    return _unpacked(payload).run(index)
