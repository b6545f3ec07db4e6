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

from jaxscp import libraries

LIBRARY = libraries.SWEEP
(TARGET,) = LIBRARY.targets
