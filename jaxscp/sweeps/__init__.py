"""One pass through the intervals: the path, its tangents, and the curvature of the slopes at a price.

In the order in which they build on each other:

    intervals.py  what a pass goes through, and what it finds
    symbols.py    arithmetic on numbers that are not known yet
    tracing.py    from a function of arrays to the operations on numbers that it is made of
    tape.py       those operations in order, with a place for each number
    slopes.py     the tape of a stage's slopes and their derivatives
    compiled.py   the pass in C++, which plays such tapes, for CPUs; native/ is the C++
    played.py     the pass in JAX that plays them, for other devices
    passes.py     the pass as JAX differentiates it, and which of these is taken
"""

from jaxscp.sweeps.intervals import Intervals, Pass, controls_at
from jaxscp.sweeps.passes import sweep

__all__ = ["Intervals", "Pass", "controls_at", "sweep"]
