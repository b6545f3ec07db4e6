"""The C++ of the pass, as compiled for this machine, and the kernel's for NVIDIA GPUs.

In the order in which they build on each other:

    tape.h         operations on numbers, for two packs of intervals at once
    functions.h    a function and its derivatives, as tapes
    sweep.h        what a pass is told
    description.h  how it is told it
    walk.h         the path and what it leads to
    prices.h       from prices of that to prices of the slopes
    tangents.h     the Jacobian and the curvature
    handler.cc     what XLA calls
    source.py      the text of the kernel, from a tape; ``kernel.py`` compiles it
    gpu_handler.cc what XLA calls to launch it
"""

from jaxscp.backends import libraries

LIBRARY = libraries.SWEEP
(TARGET,) = LIBRARY.targets
