"""One rule on the values of a mission, and numbers in its message."""

from typing import Any, NamedTuple

import numpy as np


class Rule(NamedTuple):
    """One requirement."""

    holds: Any
    """Array of one boolean."""
    message: str
    """Field and likely cause, for when it does not hold."""


def short(value: Any) -> str:
    """A number in three digits; one that is traced stands for no message.

    Example:
        >>> short(0.123456)
        '0.123'
    """
    return f"{float(value):.3g}" if isinstance(value, float | np.ndarray) else str(value)
