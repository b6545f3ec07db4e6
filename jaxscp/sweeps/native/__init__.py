"""The C++ of the pass, as compiled for this machine.

In the order in which they build on each other:

    tape.h         operations on numbers, for two packs of intervals at once
    functions.h    a function and its derivatives, as tapes
    sweep.h        what a pass is told
    description.h  how it is told it
    walk.h         the path and what it leads to
    prices.h       from prices of that to prices of the slopes
    tangents.h     the Jacobian and the curvature
    handler.cc     what XLA calls
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
