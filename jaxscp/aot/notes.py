"""XLA's notes on programs that it loads: false alarms are dropped, all other lines stay.

XLA's log level is fixed when JAX is imported, so that a library can filter its lines only on their way to the terminal.
"""

import contextlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from typing import IO

FALSE_ALARMS = (
    b"Assume version compatibility",  # the file's fingerprint has the versions
    b"could lead to execution errors such as SIGILL",  # preferences of the compiler count as instructions there
)

_lock = threading.Lock()
_users = 0
_terminal = -1
_lines: IO[bytes] | None = None


@contextlib.contextmanager
def without_false_alarms() -> Iterator[None]:
    """Drop XLA's false alarms; threads may be inside together.

    What the process writes to file descriptor 2 meanwhile appears when the last thread leaves.
    """
    _enter()
    try:
        yield
    finally:
        _leave()


def worth_telling(written: bytes) -> bytes:
    """The lines that are no false alarm.

    Example:
        >>> worth_telling(b"W1 file.cc:1] Assume version compatibility.\\nE1 file.cc:2] disk full\\n")
        b'E1 file.cc:2] disk full\\n'
    """
    return b"".join(
        line for line in written.splitlines(keepends=True) if not any(alarm in line for alarm in FALSE_ALARMS)
    )


def _enter() -> None:
    global _users, _terminal, _lines
    with _lock:
        _users += 1
        if _users > 1:
            return
        with contextlib.suppress(OSError):  # no descriptor 2, or no folder for the file: nothing is dropped
            if sys.stderr is not None:
                sys.stderr.flush()
            _lines = tempfile.TemporaryFile()  # noqa: SIM115, as the last thread closes it
            _terminal = os.dup(2)
            os.dup2(_lines.fileno(), 2)


def _leave() -> None:
    global _users, _terminal, _lines
    with _lock:
        _users -= 1
        if _users > 0 or _lines is None:
            return
        if _terminal >= 0:
            os.dup2(_terminal, 2)
            os.close(_terminal)
            _lines.seek(0)
            os.write(2, worth_telling(_lines.read()))
        _lines.close()
        _terminal, _lines = -1, None
