"""One input of the fuzzer, and how it ended."""

from collections.abc import Callable
from typing import Any, NamedTuple

FAULTS = "crash", "hang", "traceback", "nan", "refuted"
"""Endings that no input may have."""
GOOD = "converged", "accepted"
"""Endings that a valid input should have: a plan, or a file that was read or a command that ran."""


class Case(NamedTuple):
    """An input, made from a seed; nothing of it has run yet."""

    kind: str
    """``scenario``, ``corridor``, ``cloud``, ``file`` or ``command``."""
    mutation: str
    """Mutation that made it wrong; empty for a valid input."""
    run: Callable[[], "Ending"]


class Ending(NamedTuple):
    """How an input ended."""

    name: str
    """``converged``, ``accepted``, ``refused`` (with a message), the name of another status, or one of ``FAULTS``."""
    detail: str = ""
    """Message, or faults that the oracle found."""


class Record(NamedTuple):
    """A case with its ending, as it passes between processes."""

    number: int
    kind: str
    mutation: str
    ending: str
    detail: str
    seconds: float


def refused(error: Exception) -> Ending:
    """The ending of an error that a wrong input may raise: it must say something."""
    text = str(error).strip()
    return (
        Ending("refused", text) if text else Ending("traceback", f"{type(error).__name__} without a message")
    )


def any_of(rng: Any, table: dict[str, Any], valid: float) -> str:
    """Name of a mutation; empty, for none, with that probability."""
    names = list(table)
    return "" if rng.random() < valid else names[rng.integers(len(names))]
