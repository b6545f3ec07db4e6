"""The C++ of the pass, as compiled for this machine.

tape.h       operations on numbers, for eight intervals at once
sweep.h      the Runge-Kutta method with its tangents and the curvature
handler.cc   what XLA calls
"""

import functools
from pathlib import Path

from jaxscp import libraries

TARGET = "jaxscp_sweep"


STEM = Path(__file__).with_name("sweep")


def available() -> bool:
    """Whether it was compiled for this machine; makes it known to XLA."""
    return level() is not None


@functools.cache
def level() -> str | None:
    """The instruction set that it is compiled for here, if it is; see ``libraries.LEVELS``."""
    found = libraries.fastest(STEM)
    return found[0] if found and libraries.register(found[1], TARGET) else None
