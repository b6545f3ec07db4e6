"""Progress of a sweep: a bar, plain lines, lines of JSON, or nothing."""

import dataclasses
import json
import sys
import time
from typing import Any, Protocol, TextIO, runtime_checkable

from jaxscp.monte_carlo.intervals import Interval


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """Where a sweep is.

    Args:
        done: cases that are stored.
        total: cases of the study.
        failures: cases without success so far; None where the results have no success.
        share: of successes so far, with Wilson's interval of this moment; None for samplers without intervals.
        rate: cases a second of this call.
        seconds_left: by that rate; None before the first chunk.
    """

    done: int
    total: int
    failures: int | None
    share: Interval | None
    rate: float
    seconds_left: float | None

    def text(self) -> str:
        """A line.

        Example:
            >>> Snapshot(200, 1000, 10, None, 20.0, 40.0).text()
            '200 of 1000 cases, 10 failed, 20 a second, 40 s left'
        """
        parts = [f"{self.done} of {self.total} cases"]
        if self.failures is not None:
            parts.append(f"{self.failures} failed")
        if self.share is not None:
            parts.append(
                f"success {100 * self.share.estimate:.2f} % "
                f"({100 * self.share.lower:.2f} to {100 * self.share.upper:.2f})"
            )
        parts.append(f"{self.rate:.3g} a second")
        if self.seconds_left is not None:
            parts.append(f"{self.seconds_left:.0f} s left")
        return ", ".join(parts)


@runtime_checkable
class Progress(Protocol):
    """Shows snapshots and messages."""

    def update(self, snapshot: Snapshot) -> None:
        """After every chunk."""
        ...

    def message(self, text: str) -> None:
        """A line of its own."""
        ...

    def close(self) -> None:
        """At the end."""
        ...


class Silent:
    """Shows nothing."""

    def update(self, snapshot: Snapshot) -> None:
        """See ``Progress``."""

    def message(self, text: str) -> None:
        """See ``Progress``."""

    def close(self) -> None:
        """See ``Progress``."""


class Lines:
    """A line every few seconds, for logs.

    Args:
        every: seconds between lines.
        stream: to write to; standard error by default.
    """

    def __init__(self, every: float = 10.0, stream: TextIO | None = None):
        self.every, self.stream = every, stream
        self._last = -float("inf")

    def update(self, snapshot: Snapshot) -> None:
        """See ``Progress``."""
        now = time.monotonic()
        if now - self._last >= self.every or snapshot.done >= snapshot.total:
            self._last = now
            self.message(snapshot.text())

    def message(self, text: str) -> None:
        """See ``Progress``."""
        print(text, file=self.stream or sys.stderr, flush=True)

    def close(self) -> None:
        """See ``Progress``."""


class JSONLines(Lines):
    """One JSON object a chunk, for programs."""

    def update(self, snapshot: Snapshot) -> None:
        """See ``Progress``."""
        share = snapshot.share and snapshot.share._asdict()
        self._write({"event": "progress", **dataclasses.asdict(snapshot), "share": share})

    def message(self, text: str) -> None:
        """See ``Progress``."""
        self._write({"event": "message", "text": text})

    def _write(self, content: dict[str, Any]) -> None:
        print(json.dumps(content), file=self.stream or sys.stderr, flush=True)


class Bar:
    """A bar of rich on a terminal, with rate, failures, estimate and time left; plain lines elsewhere."""

    def __init__(self):
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        console = Console(stderr=True)
        self._lines = None if console.is_terminal else Lines()
        self._bar = Progress(BarColumn(bar_width=30), TextColumn("{task.description}"), console=console)
        self._task: Any = None

    def update(self, snapshot: Snapshot) -> None:
        """See ``Progress``."""
        if self._lines is not None:
            self._lines.update(snapshot)
            return
        if self._task is None:
            self._bar.start()
            self._task = self._bar.add_task("", total=snapshot.total)
        self._bar.update(self._task, completed=snapshot.done, description=snapshot.text())

    def message(self, text: str) -> None:
        """See ``Progress``."""
        if self._lines is not None:
            self._lines.message(text)
        else:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def close(self) -> None:
        """See ``Progress``."""
        if self._task is not None:  # rich prints an empty line even where nothing was begun
            self._bar.stop()
