"""One pass through the intervals: the path, its tangents, and the curvature of the slopes at a price.

__init__.py   what is asked for, in JAX, and which way it is found
symbols.py    arithmetic on numbers that are not known yet
tracing.py    from a function of arrays to the operations on numbers that it is made of
tape.py       those operations in order, with a place for each number
compiled.py   the pass in C++, which plays such tapes: eight intervals at once
native        its C++
"""

from jaxscp.sweeps.passes import Intervals, Pass, sweep

__all__ = ["Intervals", "Pass", "sweep"]
