"""The C++ of the pass, as compiled for this machine.

In the order in which they build on each other:

    tape.h       operations on numbers, for sixteen intervals at once
    sweep.h      the Runge-Kutta method with its tangents and the curvature
    handler.cc   what XLA calls
"""

from pathlib import Path

from jaxscp import libraries

TARGET = "jaxscp_sweep"
STEM = Path(__file__).with_name("sweep")


def available() -> bool:
    """Whether it was compiled for this machine; makes it known to XLA."""
    return level() is not None


def level() -> str | None:
    """The instruction set that it is compiled for here, if it is; see ``libraries.LEVELS``."""
    return libraries.level(STEM, TARGET)
